"""Training of the evaluator's movement encoder, as an autoencoder (Guo et al. 2022)."""

import dataclasses
import functools
import logging
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, Key

from t2m_jax.checkpoints.run import restore_latest
from t2m_jax.data.banks.motions import MotionBank, Windows, batch_at, make_bank
from t2m_jax.data.folder import Clip, Dataset
from t2m_jax.losses import movement_loss
from t2m_jax.models.evaluator import Evaluator, MovementDecoder
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.train.config import compiled_config
from t2m_jax.train.evaluator_config import TrainEvaluatorConfig
from t2m_jax.train.experiment import Setup, Validation, run_setup
from t2m_jax.train.optimizer import Metrics, TrainState, descend, first_state
from t2m_jax.train.streams import stream_key

logger = logging.getLogger(__name__)

MOVEMENTS = "movement_encoder"
"""Name of the module."""
MOVEMENT_FOLDER = "movement"
"""Folder of a run with the metrics and checkpoints of this training."""


def make_decoder(config: TrainEvaluatorConfig) -> MovementDecoder:
    """Returns the decoder that the movement encoder is trained with."""
    return MovementDecoder(config.decoder_hidden, config.model.feature_dim)


@functools.partial(jax.jit, static_argnames="config")
def init_movement_state(config: TrainEvaluatorConfig, key: Key[Array, ""]) -> TrainState:
    """Returns the state before the first update, with `movement_encoder` and `decoder`; `key` is consumed."""
    encoder_key, decoder_key = jax.random.split(key)
    motion = jnp.zeros((1, config.window, config.model.feature_dim))
    movements = jnp.zeros((1, 1, config.model.movement_dim))
    encoder = Evaluator(config.model).init(encoder_key, motion, train=False, method="movements")
    params = encoder["params"] | {"decoder": make_decoder(config).init(decoder_key, movements)["params"]}
    return first_state(params, config.movement_optimizer)


def movement_metrics(
    params: Any, windows: Windows, key: Key[Array, ""] | None, *, config: TrainEvaluatorConfig
) -> Metrics:
    """Returns the terms of the autoencoder's loss; `key` (consumed) is for dropout, which None turns off.

    The original has dropout in validation too.
    """
    rngs = {} if key is None else {"dropout": key}
    variables = {"params": {MOVEMENTS: params[MOVEMENTS]}}
    movements = Evaluator(config.model).apply(
        variables, windows.motion, train=key is not None, method="movements", rngs=rngs
    )
    reconstruction = make_decoder(config).apply({"params": params["decoder"]}, movements)
    return movement_loss(
        reconstruction,
        windows.motion,
        movements,
        sparsity_weight=config.sparsity_weight,
        smoothness_weight=config.smoothness_weight,
    )


def movement_train_step(
    state: TrainState, windows: Windows, key: Key[Array, ""], *, config: TrainEvaluatorConfig
) -> tuple[TrainState, Metrics]:
    """Returns the state after one update and the metrics before it; `key` is consumed."""
    return descend(
        state, lambda params: (movement_metrics(params, windows, key, config=config), {}), config.movement_optimizer
    )


@functools.partial(jax.jit, static_argnames="config", donate_argnums=0)
def update_movements(
    state: TrainState, bank: MotionBank, *, config: TrainEvaluatorConfig
) -> tuple[TrainState, Metrics]:
    """Returns the state after one step on the windows of that step; `state` is donated."""
    data_key, model_key = stream_key(config.loop.seed, "windows"), stream_key(config.loop.seed, "dropout")
    windows = batch_at(bank, data_key, state.step, batch_size=config.movement_batch_size, window=config.window)
    return movement_train_step(state, windows, jax.random.fold_in(model_key, state.step), config=config)


@functools.partial(jax.jit, static_argnames="config")
def validate_movements(
    state: TrainState, bank: MotionBank, batch: Int[Array, ""], *, config: TrainEvaluatorConfig
) -> Metrics:
    """Returns the losses on a batch of held-out windows, without dropout."""
    key = stream_key(config.loop.seed, "validation")
    windows = batch_at(bank, key, batch, batch_size=config.movement_batch_size, window=config.window)
    return movement_metrics(state.params, windows, None, config=config)


def train_movements(
    config: TrainEvaluatorConfig,
    dataset: Dataset,
    normalizer: Normalizer,
    *,
    train: Sequence[Clip],
    validation: Sequence[Clip],
    resume: bool,
) -> Any:
    """Returns the trained weights of the movement encoder; a finished training is only loaded."""
    run, compiled = config.run / MOVEMENT_FOLDER, compiled_config(config)
    clips, held_out = ([clip for clip in part if len(clip.features) >= config.window] for part in (train, validation))

    def init() -> TrainState:
        return init_movement_state(compiled, stream_key(config.loop.seed, "movements"))

    state = restore_latest(run, init()) if resume else init()
    if int(state.step) >= config.movement_steps:
        return state.params[MOVEMENTS]
    logger.info("first the movement encoder, %d steps", config.movement_steps)
    measure = functools.partial(validate_movements, config=compiled)
    setup = Setup(
        dataset=dataset,
        clips=clips,
        data=make_bank(clips, normalizer),
        init=init,
        update=functools.partial(update_movements, config=compiled),
        optimizer=config.movement_optimizer,
        frames_per_step=config.movement_batch_size * config.window,
        weights=lambda state: {"params": state.params},
        validation=Validation(make_bank(held_out, normalizer), len(held_out), measure) if held_out else None,
    )
    loop = dataclasses.replace(config.loop, num_steps=config.movement_steps, batch_size=config.movement_batch_size)
    return run_setup(run, state, setup, loop).params[MOVEMENTS]
