"""`t2m train evaluator`: from a data-set folder to a run directory that is an evaluator."""

import dataclasses
import functools
import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from t2m_jax.checkpoints.evaluator import WORDS_FILE, save_evaluator_parts
from t2m_jax.checkpoints.run import create_run, restore_latest
from t2m_jax.data.banks.captions import CaptionBank, all_tokens, caption_batch_at, make_caption_bank
from t2m_jax.data.banks.motions import MotionBank, batch_at, make_bank
from t2m_jax.data.folder import Clip, Dataset, open_dataset, samples_from_clip
from t2m_jax.errors import UserError
from t2m_jax.models.evaluator import FRAMES_PER_MOVEMENT
from t2m_jax.motion.normalizer import Normalizer, weighted_normalizer
from t2m_jax.text.word_vectors import Vocabulary, load_vocabulary, load_word_vectors, vocabulary_from_captions
from t2m_jax.train.best_weights import BestWeights
from t2m_jax.train.config import computation
from t2m_jax.train.evaluator import (
    MOVEMENTS,
    MatchingState,
    MovementState,
    init_matching_state,
    init_movement_state,
    matching_metrics,
    matching_train_step,
    movement_metrics,
    movement_train_step,
)
from t2m_jax.train.evaluator_config import TrainEvaluatorConfig
from t2m_jax.train.loop import Metrics, mean_over_batches, run_loop
from t2m_jax.train.resume import check_start
from t2m_jax.train.streams import stream_key

logger = logging.getLogger(__name__)

MOVEMENT_FOLDER = "movement"
"""Folder of a run that holds the training of the movement encoder: its metrics and checkpoints."""


class EvaluatorData(NamedTuple):
    """What an evaluator is trained on."""

    dataset: Dataset
    normalizer: Normalizer
    train: Sequence[Clip]
    """Whole clips."""
    validation: Sequence[Clip]
    max_frames: int

    def samples(self, clips: Sequence[Clip]) -> list[Clip]:
        """Returns what text-to-motion counts of some clips; what is shorter than a movement is left out."""
        found = [sample for clip in clips for sample in samples_from_clip(clip, self.dataset.info)]
        return [sample for sample in found if len(sample.features) >= FRAMES_PER_MOVEMENT]


def open_evaluator_data(config: TrainEvaluatorConfig) -> EvaluatorData:
    """Returns the data of a config.

    Raises:
        UserError: if they are of another width than the model, or no clip is left.
    """
    dataset = open_dataset(config.data)
    if dataset.skeleton.feature_dim != config.model.feature_dim:
        raise UserError(
            f"{config.data}: has {dataset.skeleton.feature_dim} features a frame, but model.feature_dim is "
            f"{config.model.feature_dim}; set it to match"
        )
    normalizer = weighted_normalizer(dataset.normalizer, dataset.skeleton.layout, factor=config.root_weight)
    train = dataset.clips("train", fraction=config.data_fraction)
    validation = dataset.clips("val") if config.loop.validate_every else []
    return EvaluatorData(dataset, normalizer, train, validation, dataset.info.max_frames)


@functools.partial(jax.jit, static_argnames="config", donate_argnums=0)
def update_movements(
    state: MovementState, bank: MotionBank, *, config: TrainEvaluatorConfig
) -> tuple[MovementState, Metrics]:
    """Returns the state after one step on the windows that belong to it; `state` is donated."""
    data_key, model_key = stream_key(config.loop.seed, "windows"), stream_key(config.loop.seed, "dropout")
    windows = batch_at(bank, data_key, state.step, batch_size=config.movement_batch_size, window=config.window)
    return movement_train_step(state, windows, jax.random.fold_in(model_key, state.step), config=config)


@functools.partial(jax.jit, static_argnames="config")
def _validate_movements(
    state: MovementState, bank: MotionBank, batch: Int[Array, ""], *, config: TrainEvaluatorConfig
) -> Metrics:
    key = stream_key(config.loop.seed, "validation")
    windows = batch_at(bank, key, batch, batch_size=config.movement_batch_size, window=config.window)
    return movement_metrics(state.params, windows, None, config=config)


def _step_config(config: TrainEvaluatorConfig) -> TrainEvaluatorConfig:
    """Returns a config with everything at one value that does not change what a step computes (see `computation`)."""
    return dataclasses.replace(computation(config), words=None, min_count=1, movement_steps=1, patience=0)


def _shift(config: TrainEvaluatorConfig, stream: str, step: Int[Array, ""]) -> Int[Array, ""]:
    """Returns how far a step's negatives are; 0 is among what the original draws, B - 1 is not."""
    key = jax.random.fold_in(stream_key(config.loop.seed, stream), step)
    return jax.random.randint(key, (), 0, config.loop.batch_size - 1)


@functools.partial(jax.jit, static_argnames=("config", "max_frames"), donate_argnums=0)
def update(
    state: MatchingState, bank: CaptionBank, *, config: TrainEvaluatorConfig, max_frames: int
) -> tuple[MatchingState, Metrics]:
    """Returns the state after one step on the batch that belongs to it; `state` is donated."""
    key, size = stream_key(config.loop.seed, "data"), config.loop.batch_size
    batch = caption_batch_at(bank, key, state.step, batch_size=size, max_frames=max_frames)
    return matching_train_step(state, batch, _shift(config, "shift", state.step), config=config)


@functools.partial(jax.jit, static_argnames=("config", "max_frames"))
def _validate_matching(
    state: MatchingState, bank: CaptionBank, step: Int[Array, ""], *, config: TrainEvaluatorConfig, max_frames: int
) -> Metrics:
    key, size = stream_key(config.loop.seed, "validation"), config.loop.batch_size
    batch = caption_batch_at(bank, key, step, batch_size=size, max_frames=max_frames)
    return matching_metrics(state.params, batch, _shift(config, "validation shift", step), config=config)


def train_movements(config: TrainEvaluatorConfig, data: EvaluatorData, *, resume: bool) -> Any:
    """Returns the trained weights of the movement encoder."""
    run, compiled = config.run / MOVEMENT_FOLDER, _step_config(config)
    state = init_movement_state(compiled, stream_key(config.loop.seed, "movements"))
    if resume:
        state = restore_latest(run, state)
    if int(state.step) < config.movement_steps:
        logger.info("first the movement encoder, %d steps", config.movement_steps)
        long_enough = [clip for clip in data.train if len(clip.features) >= config.window]
        bank = make_bank(long_enough, data.normalizer)
        loop = dataclasses.replace(config.loop, num_steps=config.movement_steps)
        validate = _movement_validation(config, data)
        state = run_loop(
            run, state, lambda state: update_movements(state, bank, config=compiled), config=loop, validate=validate
        )
    return state.params[MOVEMENTS]


def _movement_validation(
    config: TrainEvaluatorConfig, data: EvaluatorData
) -> Callable[[MovementState], Mapping[str, float]] | None:
    clips = [clip for clip in data.validation if len(clip.features) >= config.window]
    if not clips:
        return None
    bank, compiled = make_bank(clips, data.normalizer), _step_config(config)
    num_batches = max(len(clips) // config.movement_batch_size, 1)
    return lambda state: mean_over_batches(
        lambda batch: _validate_movements(state, bank, batch, config=compiled), num_batches
    )


def _matching_validation(
    config: TrainEvaluatorConfig,
    data: EvaluatorData,
    samples: Sequence[Clip],
    vocabulary: Vocabulary,
    best: BestWeights,
) -> Callable[[MatchingState], Mapping[str, float]] | None:
    """Returns a function from state to mean metrics that also keeps the best weights; None without samples."""
    if not samples:
        return None
    bank, compiled = make_caption_bank(samples, data.normalizer, vocabulary), _step_config(config)
    num_batches = max(len(samples) // config.loop.batch_size, 1)
    measure = functools.partial(_validate_matching, config=compiled, max_frames=data.max_frames)

    def validate(state: MatchingState) -> Mapping[str, float]:
        scores = mean_over_batches(lambda batch: measure(state, bank, batch), num_batches)
        best.see(int(state.step), scores["loss"], state.params)
        return scores

    return validate


def make_vocabulary(config: TrainEvaluatorConfig, samples: Sequence[Clip], *, resume: bool) -> Vocabulary:
    """Returns the words of a run: those it began with, a given list, or those of the training captions."""
    if resume:
        return load_vocabulary(config.run / WORDS_FILE)
    if config.words is not None:
        return load_vocabulary(config.words)
    return vocabulary_from_captions(all_tokens(samples), min_count=config.min_count)


def _word_vectors(config: TrainEvaluatorConfig, vocabulary: Vocabulary) -> Array | None:
    """Returns the given word vectors, None where they are learned."""
    if config.word_vectors is None:
        return None
    table = load_word_vectors(config.word_vectors, vocabulary.words)
    if table.shape[1] != config.model.word_dim:
        raise UserError(
            f"{config.word_vectors}: vectors of {table.shape[1]} numbers, but model.word_dim is "
            f"{config.model.word_dim}; set it to match"
        )
    return jnp.asarray(table)


def train_evaluator(config: TrainEvaluatorConfig, *, resume: bool = False) -> MatchingState:
    """Returns the trained state; the run directory is an evaluator, the best on validation so far.

    Raises:
        UserError: if data, words and model do not fit, the run exists (or, to resume, does not), or a loss is infinite.
    """
    check_start(config.run, config, resume=resume)
    data = open_evaluator_data(config)
    samples = data.samples(data.train)
    vocabulary = make_vocabulary(config, samples, resume=resume)
    word_vectors = _word_vectors(config, vocabulary)
    bank = make_caption_bank(samples, data.normalizer, vocabulary)
    sized = dataclasses.replace(config, model=dataclasses.replace(config.model, num_words=len(vocabulary)))
    compiled = _step_config(sized)
    if not resume:
        save_evaluator_parts(config.run, sized.model, data.normalizer, vocabulary)
        create_run(config.run, "evaluator", config)
    movement_encoder = train_movements(sized, data, resume=resume)
    state = init_matching_state(compiled, stream_key(config.loop.seed, "init"), movement_encoder, word_vectors)
    if resume:
        state = restore_latest(config.run, state)
    held_out = data.samples(data.validation)
    patience = config.patience * config.loop.validate_every if held_out else 0
    best = BestWeights(config.run, patience=patience, resume=resume)
    state = run_loop(
        config.run,
        state,
        lambda state: update(state, bank, config=compiled, max_frames=data.max_frames),
        config=config.loop,
        validate=_matching_validation(sized, data, held_out, vocabulary, best),
        is_over=best.is_over,
    )
    best.keep_last(state.params)
    return state
