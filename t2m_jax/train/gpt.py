"""Training of the GPT together with its caption encoder: state, one pure step, validation."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int, Key

from t2m_jax.losses import token_loss
from t2m_jax.models.caption_encoder import CaptionEncoder
from t2m_jax.models.motion_gpt import MotionGpt
from t2m_jax.train.config import TrainGptConfig
from t2m_jax.train.schedules import make_optimizer
from t2m_jax.train.targets import Targets, random_corruption

Metrics = dict[str, Float[Array, ""]]


class GptBatch(NamedTuple):
    """Targets and their captions."""

    targets: Targets
    caption_tokens: Int[Array, "B S"]
    caption_mask: Bool[Array, "B S"]


class GptState(NamedTuple):
    """Everything an update changes; `params` holds `gpt` and `caption_encoder`."""

    step: Int[Array, ""]
    params: Any
    opt_state: optax.OptState


@functools.partial(jax.jit, static_argnames="config")
def init_gpt_state(config: TrainGptConfig, key: Key[Array, ""]) -> GptState:
    """Returns the state before the first update; `key` is consumed."""
    gpt_key, caption_key = jax.random.split(key)
    tokens = jnp.zeros((1, config.model.max_codes), jnp.int32)
    text = jnp.zeros((1, config.model.text_dim))
    captions = jnp.zeros((1, config.caption_encoder.max_length), jnp.int32)
    mask = jnp.ones(captions.shape, bool)
    gpt = MotionGpt(config.model).init(gpt_key, tokens, text, train=False)
    caption_encoder = CaptionEncoder(config.caption_encoder).init(caption_key, captions, mask, train=False)
    params = {"gpt": gpt["params"], "caption_encoder": caption_encoder["params"]}
    return GptState(jnp.array(0, jnp.int32), params, make_optimizer(config.optimizer).init(params))


def gpt_metrics(
    params: Any, batch: GptBatch, keys: tuple[Key[Array, ""], ...] | None, *, config: TrainGptConfig
) -> Metrics:
    """Returns loss and accuracy; with `keys` (corruption, captions, GPT) as in training, without as in validation."""
    inputs = batch.targets.tokens[:, :-1]
    train = keys is not None
    rngs: list[dict[str, Key[Array, ""]]] = [{}, {}]
    if keys is not None:
        corruption_key, *dropout_keys = keys
        inputs = random_corruption(
            inputs, corruption_key, keep_probability=config.keep_probability, num_codes=config.model.num_codes
        )
        rngs = [{"dropout": key} for key in dropout_keys]
    text_embedding = CaptionEncoder(config.caption_encoder).apply(
        {"params": params["caption_encoder"]}, batch.caption_tokens, batch.caption_mask, train=train, rngs=rngs[0]
    )
    logits = MotionGpt(config.model).apply({"params": params["gpt"]}, inputs, text_embedding, train=train, rngs=rngs[1])
    loss, accuracy = token_loss(logits, batch.targets.tokens, batch.targets.code_lengths)
    return {"loss": loss, "accuracy": accuracy}


def gpt_train_step(
    state: GptState, batch: GptBatch, key: Key[Array, ""], *, config: TrainGptConfig
) -> tuple[GptState, Metrics]:
    """Returns the state after one update and the metrics before it; `key` is consumed."""
    keys = tuple(jax.random.split(key, 3))

    def objective(params: Any) -> tuple[Float[Array, ""], Metrics]:
        metrics = gpt_metrics(params, batch, keys, config=config)
        return metrics["loss"], metrics

    (_, metrics), gradient = jax.value_and_grad(objective, has_aux=True)(state.params)
    updates, opt_state = make_optimizer(config.optimizer).update(gradient, state.opt_state, state.params)
    return GptState(state.step + 1, optax.apply_updates(state.params, updates), opt_state), metrics


def gpt_validation_step(state: GptState, batch: GptBatch, *, config: TrainGptConfig) -> Metrics:
    """Returns loss and accuracy on held-out motions with clean inputs."""
    return gpt_metrics(state.params, batch, None, config=config)
