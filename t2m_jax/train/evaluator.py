"""Training of the evaluator: two states, two pure steps, validation (Guo et al. 2022)."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, Key

from t2m_jax.data.banks.captions import CaptionBatch
from t2m_jax.data.banks.motions import Windows
from t2m_jax.losses import infonce_loss, margin_loss, movement_loss, pair_distances
from t2m_jax.metrics import r_precision
from t2m_jax.models.evaluator import Evaluator, MovementDecoder
from t2m_jax.train.evaluator_config import TrainEvaluatorConfig
from t2m_jax.train.optimizer import make_optimizer

Metrics = dict[str, Float[Array, ""]]

MOTION_PARTS = ("motion_encoder",)
TEXT_PARTS = ("text_encoder", "part_of_speech_projection")
WORDS = "word_embedding"
MOVEMENTS = "movement_encoder"


class MovementState(NamedTuple):
    """Everything an update of the movement encoder changes; `params` holds `movement_encoder` and `decoder`."""

    step: Int[Array, ""]
    params: Any
    opt_state: optax.OptState


class MatchingState(NamedTuple):
    """Everything an update of the matching changes; `params` is the whole evaluator's."""

    step: Int[Array, ""]
    params: Any
    opt_state: Any
    """Of `motion` and of `text`."""


def _decoder(config: TrainEvaluatorConfig) -> MovementDecoder:
    return MovementDecoder(config.decoder_hidden, config.model.feature_dim)


@functools.partial(jax.jit, static_argnames="config")
def init_movement_state(config: TrainEvaluatorConfig, key: Key[Array, ""]) -> MovementState:
    """Returns the state before the first update; `key` is consumed."""
    encoder_key, decoder_key = jax.random.split(key)
    motion = jnp.zeros((1, config.window, config.model.feature_dim))
    movements = jnp.zeros((1, 1, config.model.movement_dim))
    encoder = Evaluator(config.model).init(encoder_key, motion, train=False, method="movements")
    params = encoder["params"] | {"decoder": _decoder(config).init(decoder_key, movements)["params"]}
    opt_state = make_optimizer(config.movement_optimizer).init(params)
    return MovementState(jnp.array(0, jnp.int32), params, opt_state)


def movement_metrics(
    params: Any, windows: Windows, key: Key[Array, ""] | None, *, config: TrainEvaluatorConfig
) -> Metrics:
    """Returns the terms of the autoencoder's loss; with `key` (consumed) the encoder drops out.

    The original drops out in validation, too.
    """
    rngs = {} if key is None else {"dropout": key}
    variables = {"params": {MOVEMENTS: params[MOVEMENTS]}}
    movements = Evaluator(config.model).apply(
        variables, windows.motion, train=key is not None, method="movements", rngs=rngs
    )
    reconstruction = _decoder(config).apply({"params": params["decoder"]}, movements)
    return movement_loss(
        reconstruction,
        windows.motion,
        movements,
        sparsity_weight=config.sparsity_weight,
        smoothness_weight=config.smoothness_weight,
    )


def movement_train_step(
    state: MovementState, windows: Windows, key: Key[Array, ""], *, config: TrainEvaluatorConfig
) -> tuple[MovementState, Metrics]:
    """Returns the state after one update and the metrics before it; `key` is consumed."""

    def objective(params: Any) -> tuple[Float[Array, ""], Metrics]:
        metrics = movement_metrics(params, windows, key, config=config)
        return metrics["loss"], metrics

    (_, metrics), gradient = jax.value_and_grad(objective, has_aux=True)(state.params)
    updates, opt_state = make_optimizer(config.movement_optimizer).update(gradient, state.opt_state, state.params)
    return MovementState(state.step + 1, optax.apply_updates(state.params, updates), opt_state), metrics


def trained_parts(params: Any, config: TrainEvaluatorConfig) -> dict[str, Any]:
    """Returns what the matching trains, by encoder: not the movements, and word vectors only where none are given."""
    text = (*TEXT_PARTS, WORDS) if config.word_vectors is None else TEXT_PARTS
    return {
        "motion": {name: params[name] for name in MOTION_PARTS},
        "text": {name: params[name] for name in text},
    }


@functools.partial(jax.jit, static_argnames="config")
def init_matching_state(
    config: TrainEvaluatorConfig,
    key: Key[Array, ""],
    movement_encoder: Any,
    word_vectors: Float[Array, "W X"] | None,
) -> MatchingState:
    """Returns the state before the first update; `key` is consumed.

    Args:
        config: Sizes.
        key: For all weights that are not given.
        movement_encoder: Its trained weights.
        word_vectors: A table that is left as it is; None learns one.
    """
    motion = jnp.zeros((1, config.window, config.model.feature_dim))
    words, length = jnp.zeros((1, 1), jnp.int32), jnp.ones(1, jnp.int32)
    params = dict(Evaluator(config.model).init(key, motion, length, words, words, length)["params"])
    params[MOVEMENTS] = movement_encoder
    if word_vectors is not None:
        params[WORDS] = {"embedding": word_vectors}
    optimizer = make_optimizer(config.optimizer)
    opt_state = {name: optimizer.init(part) for name, part in trained_parts(params, config).items()}
    return MatchingState(jnp.array(0, jnp.int32), params, opt_state)


def matching_metrics(
    params: Any, batch: CaptionBatch, shift: Int[Array, ""], *, config: TrainEvaluatorConfig
) -> Metrics:
    """Returns the loss, the mean distances of pairs and of negatives, and `top3`.

    `top3` is the share of texts whose motion is among the three nearest of the batch; what is as near shares its
    place. Pairs stand in the order of their motions' lengths, longest first, when negatives are shifted, as in the
    original.
    """
    order = jnp.argsort(-batch.lengths, stable=True)
    text, motion = Evaluator(config.model).apply({"params": params}, batch.motion, batch.lengths, *batch.captions)
    text, motion = text[order], motion[order]
    if config.objective == "margin":
        loss = margin_loss(text, motion, shift, margin=config.margin)["loss"]
    else:
        words = batch.captions.words[order]
        same = jnp.all(words[:, None] == words[None, :], axis=-1)
        loss = infonce_loss(text, motion, same, temperature=config.temperature)
    return {
        "loss": loss,
        "positive_distance": jnp.mean(pair_distances(text, motion)),
        "negative_distance": jnp.mean(pair_distances(text, jnp.roll(motion, -shift, axis=0))),
        "top3": r_precision(text, motion, batch=len(text))[2],
    }


def matching_train_step(
    state: MatchingState, batch: CaptionBatch, shift: Int[Array, ""], *, config: TrainEvaluatorConfig
) -> tuple[MatchingState, Metrics]:
    """Returns the state after one update and the metrics before it, norms of gradients before they are cut among them.

    `shift` is how far the negatives are, 0 to B - 2.
    """
    trained = trained_parts(state.params, config)

    def objective(parts: Any) -> tuple[Float[Array, ""], Metrics]:
        metrics = matching_metrics(state.params | parts["motion"] | parts["text"], batch, shift, config=config)
        return metrics["loss"], metrics

    (_, metrics), gradient = jax.value_and_grad(objective, has_aux=True)(trained)
    params, opt_state = state.params, {}
    for name, part in trained.items():
        updates, opt_state[name] = make_optimizer(config.optimizer).update(gradient[name], state.opt_state[name], part)
        params = params | optax.apply_updates(part, updates)
        squares = [jnp.sum(leaf**2) for leaf in jax.tree.leaves(gradient[name])]
        metrics[f"{name}_gradient_norm"] = jnp.sqrt(sum(squares, jnp.zeros(())))
    return MatchingState(state.step + 1, params, opt_state), metrics
