"""Training of the GPT, together with its caption encoder where it has one: state, one pure step, validation."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, Key

from t2m_jax.data.banks.codes import Captions
from t2m_jax.losses import token_loss
from t2m_jax.models.caption_encoder import CaptionEncoder
from t2m_jax.models.motion_gpt import MotionGpt
from t2m_jax.train.config import TrainGptConfig
from t2m_jax.train.optimizer import make_optimizer
from t2m_jax.train.targets import Targets, random_corruption

Metrics = dict[str, Float[Array, ""]]


class GptBatch(NamedTuple):
    """Targets and their captions."""

    targets: Targets
    captions: Captions


class GptState(NamedTuple):
    """Everything an update changes; `params` holds `gpt` and, where one is trained along, `caption_encoder`."""

    step: Int[Array, ""]
    params: Any
    opt_state: optax.OptState


@functools.partial(jax.jit, static_argnames="config")
def init_gpt_state(config: TrainGptConfig, key: Key[Array, ""]) -> GptState:
    """Returns the state before the first update; `key` is consumed."""
    gpt_key, caption_key = jax.random.split(key)
    tokens = jnp.zeros((1, config.model.max_codes), jnp.int32)
    text = jnp.zeros((1, config.model.text_dim))
    params = {"gpt": MotionGpt(config.model).init(gpt_key, tokens, text, train=False)["params"]}
    if config.text_encoder == "caption_encoder":
        captions = jnp.zeros((1, config.caption_encoder.max_length), jnp.int32)
        caption_encoder = CaptionEncoder(config.caption_encoder)
        variables = caption_encoder.init(caption_key, captions, jnp.ones(captions.shape, bool), train=False)
        params["caption_encoder"] = variables["params"]
    return GptState(jnp.array(0, jnp.int32), params, make_optimizer(config.optimizer).init(params))


def text_embeddings(
    params: Any, captions: Captions, key: Key[Array, ""] | None, *, config: TrainGptConfig
) -> Float[Array, "B E"]:
    """Returns what the GPT is told: captions read by the encoder that is trained, or CLIP's embeddings as they are.

    With `key` (consumed) the encoder drops out.
    """
    if isinstance(captions, jax.Array):
        return captions
    rngs = {} if key is None else {"dropout": key}
    return CaptionEncoder(config.caption_encoder).apply(
        {"params": params["caption_encoder"]}, captions.tokens, captions.mask, train=key is not None, rngs=rngs
    )


def gpt_metrics(
    params: Any, batch: GptBatch, keys: tuple[Key[Array, ""], ...] | None, *, config: TrainGptConfig
) -> Metrics:
    """Returns loss and accuracy; with `keys` (corruption, captions, GPT) as in training, without as in validation."""
    inputs = batch.targets.tokens[:, :-1]
    caption_key, rngs = None, {}
    if keys is not None:
        corruption_key, caption_key, gpt_key = keys
        rngs = {"dropout": gpt_key}
        inputs = random_corruption(
            inputs,
            corruption_key,
            tau=config.tau,
            num_codes=config.model.num_codes,
            past_end=config.corrupt_past_end,
        )
    text = text_embeddings(params, batch.captions, caption_key, config=config)
    logits = MotionGpt(config.model).apply({"params": params["gpt"]}, inputs, text, train=keys is not None, rngs=rngs)
    loss, accuracy = token_loss(logits, batch.targets.tokens, batch.targets.code_lengths, mean_over=config.mean_over)
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
