"""Training of the evaluator's movement encoder, as an autoencoder (Guo et al. 2022)."""

import dataclasses
import functools
import logging
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, Key

from t2m_jax.checkpoints.evaluator import load_trained_evaluator
from t2m_jax.data.banks.motions import MotionBank, Windows, batch_at, cuts_at, make_bank
from t2m_jax.data.banks.order import row_keys
from t2m_jax.data.folder import Clip, Dataset
from t2m_jax.devices import own_rows, split_rows
from t2m_jax.losses import movement_loss
from t2m_jax.models.evaluator import Evaluator, MovementDecoder, evaluator_shapes
from t2m_jax.models.rows import apply_rows
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.train.checks import checked_weights
from t2m_jax.train.config import LoopConfig, compiled_config
from t2m_jax.train.evaluator_config import EvaluatorStepConfig, TrainEvaluatorConfig
from t2m_jax.train.experiment import Setup, Validation, run_setup
from t2m_jax.train.optimizer import Metrics, TrainState, descend, first_state
from t2m_jax.train.program import Update
from t2m_jax.train.streams import plan_feed, stream_key, window_options

logger = logging.getLogger(__name__)

MOVEMENTS = "movement_encoder"
"""Name of the module."""
MOVEMENT_FOLDER = "movement"
"""Folder of a run with the metrics and checkpoints of this training."""


def make_decoder(config: EvaluatorStepConfig) -> MovementDecoder:
    """Returns the decoder that the movement encoder is trained with."""
    return MovementDecoder(config.decoder_hidden, config.model.feature_dim)


@functools.partial(jax.jit, static_argnames="config")
def init_movement_state(config: EvaluatorStepConfig, key: Key[Array, ""]) -> TrainState:
    """Returns the state before the first update, with `movement_encoder` and `decoder`; `key` is consumed."""
    encoder_key, decoder_key = jax.random.split(key)
    motion = jnp.zeros((1, config.window, config.model.feature_dim))
    movements = jnp.zeros((1, 1, config.model.movement_dim))
    encoder = Evaluator(config.model).init(encoder_key, motion, train=False, method="movements")
    # One tree, so that one optimizer trains both.
    params = encoder["params"] | {"decoder": make_decoder(config).init(decoder_key, movements)["params"]}
    return first_state(params, config.movement_optimizer)


def movement_metrics(
    params: Any, windows: Windows, keys: Key[Array, " B"] | None, *, config: EvaluatorStepConfig
) -> Metrics:
    """Returns the terms of the autoencoder's loss; `keys` (consumed) are for dropout, which None turns off.

    The original has dropout in validation too.
    """
    encoder = {MOVEMENTS: params[MOVEMENTS]}
    movements = apply_rows(Evaluator(config.model), {"params": encoder}, windows.motion, keys=keys, method="movements")
    reconstruction = make_decoder(config).apply({"params": params["decoder"]}, movements)
    return movement_loss(
        reconstruction,
        windows.motion,
        movements,
        sparsity_weight=config.sparsity_weight,
        smoothness_weight=config.smoothness_weight,
    )


def movement_loop(config: EvaluatorStepConfig) -> LoopConfig:
    """Returns the loop of a config with the batches of this training."""
    return dataclasses.replace(config.loop, batch_size=config.movement_batch_size)


def update_movements(state: TrainState, bank: MotionBank, *, config: EvaluatorStepConfig) -> tuple[TrainState, Metrics]:
    """Returns the state after one step on the windows of that step."""
    windows = batch_at(bank, step=state.step, **window_options(movement_loop(config), "windows", window=config.window))
    keys = row_keys(stream_key(config.loop.seed, "dropout"), state.step, own_rows(config.movement_batch_size))
    keys = split_rows(keys)
    return descend(
        state, lambda params: (movement_metrics(params, windows, keys, config=config), {}), config.movement_optimizer
    )


@functools.partial(jax.jit, static_argnames="config")
def validate_movements(
    state: TrainState, bank: MotionBank, batch: Int[Array, ""], *, config: EvaluatorStepConfig
) -> Metrics:
    """Returns the losses on a batch of held-out windows, without dropout."""
    windows = batch_at(bank, step=batch, **window_options(movement_loop(config), "validation", window=config.window))
    return movement_metrics(state.params, windows, None, config=config)


def train_movements(
    config: TrainEvaluatorConfig,
    dataset: Dataset,
    normalizer: Normalizer,
    train: Sequence[Clip],
    validation: Sequence[Clip],
    *,
    resume: bool,
) -> Any:
    """Returns the trained weights of the movement encoder: those of `init`, or of a training, which may be finished."""
    if config.init is not None:
        shapes = evaluator_shapes(config.model)["params"]
        given = load_trained_evaluator(config.init).variables["params"]
        return checked_weights(config.init, {MOVEMENTS: given[MOVEMENTS]}, {MOVEMENTS: shapes[MOVEMENTS]})[MOVEMENTS]
    logger.info("first the movement encoder, %d steps", config.movement_steps)
    loop = dataclasses.replace(movement_loop(config), num_steps=config.movement_steps)
    compiled = compiled_config(config)
    plan = functools.partial(plan_feed, cuts_at, loop, window=config.window)
    # A window is never padded here: padding would be learned as a movement.
    clips, held_out = ([clip for clip in part if len(clip.features) >= config.window] for part in (train, validation))
    init = functools.partial(init_movement_state, compiled, stream_key(config.loop.seed, "movements"))
    validated = None
    if held_out:
        measure = functools.partial(validate_movements, config=compiled)
        validated = Validation(make_bank(held_out, normalizer), len(held_out), measure, plan("validation"))
    setup = Setup(
        dataset=dataset,
        clips=clips,
        data=make_bank(clips, normalizer),
        init=init,
        update=Update(update_movements, config=compiled),
        plan=plan("windows"),
        optimizer=config.movement_optimizer,
        frames_per_step=config.movement_batch_size * config.window,
        weights=lambda state: {"params": state.params},
        validation=validated,
    )
    # A run within the run: resumed like it, and only loaded once it is finished.
    inner = dataclasses.replace(config, run=config.run / MOVEMENT_FOLDER)
    state = run_setup(inner, setup, init(), loop=loop, resume=resume)
    return jax.device_get(state.params[MOVEMENTS])  # without the decoder, which has done its work
