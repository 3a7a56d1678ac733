"""`t2m train vqvae`: from a data-set folder to a run directory."""

import functools
from collections.abc import Callable, Mapping

import jax

from t2m_jax.checkpoints.run import create_run, restore_latest
from t2m_jax.checkpoints.vqvae import VQVAE_CONFIG, TrainedVqVae
from t2m_jax.config import save_config
from t2m_jax.data.banks.motions import MotionBank, batch_at, make_bank
from t2m_jax.data.folder import Dataset, open_dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.monitor import held_out_figures
from t2m_jax.evaluation.sources import Reconstruction
from t2m_jax.evaluation.task import Subject
from t2m_jax.motion.normalizer import Normalizer, save_normalizer, weighted_normalizer
from t2m_jax.train.config import TrainVqVaeConfig, computation
from t2m_jax.train.evaluation import make_evaluation, open_evaluation
from t2m_jax.train.loop import Look, Metrics, mean_over_batches, run_loop
from t2m_jax.train.resume import check_start
from t2m_jax.train.streams import stream_key
from t2m_jax.train.vqvae import VqVaeState, init_vqvae_state, vqvae_train_step, vqvae_validation_step


def check_feature_dim(dataset: Dataset, feature_dim: int) -> None:
    """Raises `UserError` where a data set does not have the width a model reads."""
    if dataset.skeleton.feature_dim != feature_dim:
        raise UserError(
            f"{dataset.folder}: has {dataset.skeleton.feature_dim} features a frame, the model reads {feature_dim}; "
            "set the VQ-VAE's feature_dim to match"
        )


@functools.partial(jax.jit, static_argnames="config", donate_argnums=0)
def update(state: VqVaeState, bank: MotionBank, *, config: TrainVqVaeConfig) -> tuple[VqVaeState, Metrics]:
    """Returns the state after one step on the batch that belongs to it; `state` is donated."""
    data_key, model_key = stream_key(config.loop.seed, "data"), stream_key(config.loop.seed, "codebook")
    windows = batch_at(bank, data_key, state.step, batch_size=config.loop.batch_size, window=config.window)
    return vqvae_train_step(state, windows, jax.random.fold_in(model_key, state.step), config=config)


@functools.partial(jax.jit, static_argnames="config")
def _validation_batch(state: VqVaeState, bank: MotionBank, batch: jax.Array, *, config: TrainVqVaeConfig) -> Metrics:
    key = stream_key(config.loop.seed, "validation")
    windows = batch_at(bank, key, batch, batch_size=config.loop.batch_size, window=config.window)
    return vqvae_validation_step(state, windows, config=config)


def _make_validation(
    dataset: Dataset, normalizer: Normalizer, config: TrainVqVaeConfig
) -> Callable[[VqVaeState], Mapping[str, float]] | None:
    """Returns a function from state to mean metrics over one pass of the validation split, None where it is empty."""
    shortest = config.model.downsample if config.short_clips == "pad" else config.window
    clips = dataset.clips("val", min_frames=shortest) if config.loop.validate_every else []
    if not clips:
        return None
    bank = make_bank(clips, normalizer)
    compiled = computation(config)
    num_batches = max(len(clips) // config.loop.batch_size, 1)

    return lambda state: mean_over_batches(
        lambda batch: _validation_batch(state, bank, batch, config=compiled), num_batches
    )


def _make_evaluation(
    config: TrainVqVaeConfig, held_out: Subject | None, normalizer: Normalizer, *, resume: bool
) -> Look | None:
    """Returns the evaluation of reconstructions on the way, None where there is nothing held out."""
    if held_out is None:
        return None

    def evaluate(state: VqVaeState) -> Mapping[str, float]:
        maker = Reconstruction(TrainedVqVae(config.model, state.variables, normalizer))
        return held_out_figures(held_out, maker)

    return make_evaluation(
        config.run,
        config.evaluation,
        evaluator=held_out.evaluator.fingerprint,
        evaluate=evaluate,
        trained=lambda state: state.variables,
        sampling=None,
        resume=resume,
    )


def train_vqvae(config: TrainVqVaeConfig, *, resume: bool = False) -> VqVaeState:
    """Returns the trained state; the run directory holds config, statistics, metrics and checkpoints.

    Raises:
        UserError: if the data do not fit the model, the run exists (or, to resume, does not), or a loss is not finite.
    """
    check_start(config.run, config, resume=resume)
    dataset = open_dataset(config.data)
    check_feature_dim(dataset, config.model.feature_dim)
    held_out = open_evaluation(config.evaluation, dataset)
    normalizer = weighted_normalizer(dataset.normalizer, dataset.skeleton.layout, factor=config.root_weight)
    # The original takes every clip that a window fits into, also those its other stages find too short.
    shortest = max(config.model.downsample, dataset.info.min_frames) if config.short_clips == "pad" else config.window
    clips = dataset.clips("train", min_frames=shortest, fraction=config.data_fraction)
    bank = make_bank(clips, normalizer)
    validate = _make_validation(dataset, normalizer, config)
    evaluation = _make_evaluation(config, held_out, normalizer, resume=resume)
    compiled = computation(config)
    state = init_vqvae_state(compiled, stream_key(config.loop.seed, "init"))
    if resume:
        state = restore_latest(config.run, state)
    else:
        save_normalizer(config.run, normalizer)
        save_config(config.run / VQVAE_CONFIG, config.model)
        create_run(config.run, "vqvae", config)
    return run_loop(
        config.run,
        state,
        lambda state: update(state, bank, config=compiled),
        config=config.loop,
        validate=validate,
        evaluation=evaluation,
    )
