"""One experiment: the path that every training takes, from a config to a finished run.

A trainer is found by the kind of its config through the entry-point group `t2m_jax.trainers`. It prepares a `Setup`:
the initial state, the update, the data and what is measured. Everything else happens here, once for all: starting or
resuming, warm start, validation, evaluation, the best weights, the loop.
"""

import dataclasses
import functools
import importlib.metadata
import logging
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax

from t2m_jax.checkpoints.run import (
    DATA_FILE,
    begin_run,
    create_run,
    newest_step,
    restore_latest,
    run_info,
    save_run_config,
)
from t2m_jax.data.banks.host import FeedPlan
from t2m_jax.data.folder import Clip, Dataset
from t2m_jax.data.summary import save_training_data, summarize_training_data
from t2m_jax.devices import put_everywhere
from t2m_jax.distributed import is_writer, wait_for_all
from t2m_jax.errors import UserError
from t2m_jax.evaluation.run import HELD_OUT, held_out_metrics, open_held_out, sample_motions
from t2m_jax.evaluation.sources import CodeSource
from t2m_jax.evaluation.task import EvaluationTask
from t2m_jax.export.render.rendering import render_poster
from t2m_jax.files.manifest import check_folder
from t2m_jax.train import checks
from t2m_jax.train.best import BestWeights
from t2m_jax.train.config import EvaluationConfig, ExperimentConfig, LoopConfig
from t2m_jax.train.loop import Measured, Measurement, Metrics, Speed, mean_over_batches, run_loop, stop_requests
from t2m_jax.train.optimizer import OptimizerConfig, learning_rate_at
from t2m_jax.train.placement import DataOnDevices, DataOnHost, place_data
from t2m_jax.train.program import Devices, Update, choose_devices

logger = logging.getLogger(__name__)

GROUP = "t2m_jax.trainers"
"""The entry-point group of trainers."""
NUM_PICTURED = 2
"""Motions in the picture of an evaluation."""


class Validation(NamedTuple):
    """The loss on held-out data."""

    data: Any
    """The validation split, in the form of `Setup.data`."""
    num_clips: int
    """Clips in `data`. A validation takes as many whole batches as they fill, but at least one."""
    measure: Callable[[Any, Any, jax.Array], Metrics]
    """From a state, the data and the number of a batch to metrics with a `loss`."""
    plan: FeedPlan | None = None
    """The windows that `measure` uses, for data that stay on the host; None if they are always on the devices."""


class Evaluation(NamedTuple):
    """Metrics of the motion that the model gives, by an evaluator."""

    config: EvaluationConfig
    unit: int
    """Frames per row of codes."""
    source: Callable[[Any, Sequence[Clip]], CodeSource]
    """From a state and the clips of the evaluation to a source of codes."""
    sampling: str | None = None
    """How codes are chosen, None if they are not."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Setup:
    """What a trainer adds to the experiment."""

    dataset: Dataset
    clips: Sequence[Clip]
    """The training clips."""
    data: Any
    """The training split, from which updates cut their batches."""
    draws: str = ""
    """Fingerprint of how often each motion is drawn; empty if all are drawn equally often."""
    init: Callable[[], Any]
    """Returns the state before the first update, a `NamedTuple` with `step`."""
    update: Update
    """From a state and `data` to the next state and metrics with a `loss`."""
    plan: FeedPlan | None = None
    """The windows that `update` uses, for data that stay on the host; None if they are always on the devices."""
    optimizer: OptimizerConfig
    frames_per_step: int | float
    """For the log."""
    weights: Callable[[Any], Mapping[str, Any]]
    """The fields of a state that are the model: training state field -> tree of arrays."""
    write_parts: Callable[[Path], None] = lambda run: None
    """Writes what the run contains besides its config and its checkpoints."""
    start_from: Callable[[Path], Mapping[str, Any]] = lambda path: {}
    """Returns the weights of a trained model in the form of `weights`."""
    validation: Validation | None = None
    evaluation: Evaluation | None = None
    patience: int = 0
    """Updates without better weights after which training ends; 0 never ends it."""


class Trainer(NamedTuple):
    """How one kind of model is trained."""

    config: Callable[..., Any]
    """The config class."""
    prepare: Callable[[Any, bool], Setup]
    """From a resolved config, and whether the run is resumed, to the setup. Raises `UserError` if parts do not fit."""
    resolve: Callable[[Any, bool], Any] = lambda config, resume: config
    """From a config to one that contains values of other runs, such as the number of codes of a tokenizer."""
    next_command: str = "t2m bundle {run} DIR"
    """What users run next; `{run}` and `{data}` are replaced."""


@functools.cache
def find_trainer(kind: str) -> Trainer:
    """Returns the trainer of a kind.

    Raises:
        UserError: No installed package has such a trainer.
    """
    points = importlib.metadata.entry_points(group=GROUP)
    if kind not in points.names:
        raise UserError(f"{kind!r} cannot be trained; known: {', '.join(sorted(points.names))}")
    return points[kind].load()


def load_run_config(run: Path) -> Any:
    """Returns the config of a run.

    Raises:
        UserError: The folder is not a run, or its config is damaged.
    """
    schema: Any = find_trainer(run_info(run).kind).config
    return checks.read_run_config(run, schema)


def train(config: ExperimentConfig, *, resume: bool = False) -> Any:
    """Trains a model and returns the last state; the run directory is the result.

    Args:
        config: The config of any trainer.
        resume: Continue from the run's newest checkpoint. The result is the same as without the interruption.

    Raises:
        UserError: Data and model do not fit, the run exists (or, to resume, does not), or a loss is not finite.
    """
    with checks.claim_run(config.run):
        trainer = find_trainer(config.kind)
        if resume:
            run_info(config.run)
            check_folder(config.run)  # the statistics, sizes and words that it was started with
        else:
            checks.check_new_run(config.run)
        wait_for_all("checked")  # before process 0 creates what the others look for
        config = trainer.resolve(config, resume)
        if resume:
            checks.check_same_config(config)
        checks.warn_of_schedule(config)
        done = newest_step(config.run) if resume else 0
        if done > config.loop.num_steps:
            raise UserError(f"loop.num_steps: {config.loop.num_steps}, but {config.run} has made {done} updates")
        setup = trainer.prepare(config, resume)
        if resume:
            checks.check_same_data(config, setup.dataset, setup.draws)
        # All that can be refused is refused before anything is written, so that a mistake leaves no half a run.
        held_out = open_evaluation(setup)
        if config.sharding.devices != "auto":
            choose_devices(config.sharding, batch_size=config.loop.batch_size)
        state = None
        # A run that ended before its first checkpoint starts from `init` again, as it did the first time.
        if config.init is not None and not done:
            state = setup.init()
            given = setup.start_from(config.init)
            if config.init_parts == "fitting":
                given = checks.fitting_weights(config.init, given, setup.weights(state))
            weights = checks.checked_weights(config.init, given, setup.weights(state))
            state = state._replace(**weights)
        write_run(config, setup, resume=resume)
        wait_for_all("written")  # the others read what process 0 wrote
        state = setup.init() if state is None else state
        best = make_best(config.run, setup, held_out)
        return run_setup(config, setup, state, resume=resume, best=best, held_out=held_out)


def write_run(config: ExperimentConfig, setup: Setup, *, resume: bool) -> None:
    """Makes a folder a run, or writes the config of a run that is resumed; process 0 does it for all."""
    if not is_writer():
        return
    if resume:
        save_run_config(config.run, config)  # so that a run that is extended says so
        return
    begin_run(config.run)
    setup.write_parts(config.run)
    save_training_data(config.run / DATA_FILE, summarize_training_data(setup.dataset, setup.clips))
    create_run(config.run, config.kind, config, data=checks.data_record(setup.dataset, setup.draws))


def open_evaluation(setup: Setup) -> EvaluationTask | None:
    """Returns what a run is evaluated on, None if it has no evaluator.

    Raises:
        UserError: The evaluator is missing or does not fit the data, or the validation split is too small.
    """
    evaluation = setup.evaluation
    if evaluation is None or evaluation.config.evaluator is None:
        return None
    return open_held_out(setup.dataset, evaluation.config.evaluator, seed=evaluation.config.seed, unit=evaluation.unit)


def make_best(run: Path, setup: Setup, held_out: EvaluationTask | None) -> BestWeights | None:
    """Returns what keeps the best weights: by a metric of the evaluation if there is one, else by validation loss."""
    if held_out is not None and setup.evaluation is not None:
        metric = setup.evaluation.config.metric
        digest = held_out.evaluator.fingerprint
        return BestWeights(run, metric=metric, sampling=setup.evaluation.sampling, evaluator=digest)
    if setup.validation is None:
        return None
    if setup.evaluation is not None:
        logger.info("the best weights are those of the lowest validation loss; papers choose by FID: give an evaluator")
    return BestWeights(run)


def run_setup(
    config: ExperimentConfig,
    setup: Setup,
    state: Any,
    *,
    loop: LoopConfig | None = None,
    resume: bool = False,
    best: BestWeights | None = None,
    held_out: EvaluationTask | None = None,
) -> Any:
    """Returns the state after the loop.

    Args:
        config: Names the folder that gets the log, the checkpoints and the best weights, and the devices.
        setup: What to train.
        state: The state before the first update.
        loop: For how long, if it is not the loop of the config.
        resume: Whether to continue from the newest checkpoint.
        best: Keeps the best weights.
        held_out: What the model is evaluated on.
    """
    loop = loop or config.loop
    devices = Devices(config.sharding, batch_size=loop.batch_size)
    state = devices.put_state(state)
    if resume:
        state = restore_latest(config.run, state)
    # A training that ended by patience stays ended: to resume it changes nothing.
    if best is not None and best.is_over(int(state.step), patience=setup.patience):
        return state
    place = functools.partial(place_data, devices=devices, placement=config.placement, batch_size=loop.batch_size)
    # The papers choose weights by FID. Then the validation loss is only logged.
    measurements = measure_validation(setup, loop, devices, place, best if held_out is None else None)
    measurements += [] if held_out is None else [measure_evaluation(setup, held_out, best)]
    feed = place(setup.data, setup.plan).feed(int(state.step), loop.num_steps, size=loop.steps_per_call)
    with feed as take, stop_requests() as asked_to_stop:

        def update(state: Any, count: int) -> tuple[Any, Metrics]:
            # From here on: `Devices.run`, `many_updates`, and the trainer's own `update`.
            return devices.run(setup.update, state, take(count), count, size=loop.steps_per_call)

        return run_loop(
            config.run,
            state,
            update,
            config=loop,
            measurements=measurements,
            # Updates are counted from 0 by the schedule, and from 1 in the log.
            speed=Speed(lambda step: float(learning_rate_at(step - 1, setup.optimizer)), setup.frames_per_step),
            asked_to_stop=asked_to_stop,
        )


def measure_validation(
    setup: Setup,
    loop: LoopConfig,
    devices: Devices,
    place: Callable[[Any, FeedPlan | None], DataOnDevices | DataOnHost],
    best: BestWeights | None,
) -> list[Measurement]:
    """Returns the measurement of the validation loss, if there is one; it keeps the best weights if `best` is given."""
    validation = setup.validation
    if validation is None:
        return []
    data = place(validation.data, validation.plan)
    # Whole batches alone, because programs are compiled for their shape.
    num_batches = max(validation.num_clips // loop.batch_size, 1)

    def measure(state: Any) -> Measured:
        with data.feed(0, num_batches) as take:
            scores = mean_over_batches(
                lambda batch: devices.measure(validation.measure, state, take(1), batch), num_batches
            )
        if best is None:
            return Measured(scores)
        best.consider(int(state.step), scores, setup.weights(state))
        return Measured(scores, is_last=best.is_over(int(state.step), patience=setup.patience))

    return [Measurement("val", "validation", loop.validate_every, measure)]


def measure_evaluation(setup: Setup, held_out: EvaluationTask, best: BestWeights | None) -> Measurement:
    """Returns the measurement of the evaluator's metrics, with a picture, which keeps the best weights."""
    evaluation = setup.evaluation
    assert evaluation is not None and best is not None

    def measure(state: Any) -> Measured:
        metrics: dict[str, float] = {}
        picture = None
        if is_writer():
            # Motions are sampled on the devices of this process alone.
            weights = put_everywhere(jax.device_get(dict(setup.weights(state))))
            state = state._replace(**weights)
            source = evaluation.source(state, held_out.samples.clips)
            metrics = held_out_metrics(held_out, source)
            picture = render_poster(sample_motions(held_out, source, count=NUM_PICTURED))
            best.consider(int(state.step), metrics, setup.weights(state))
        wait_for_all("evaluated")  # the others read what process 0 found
        return Measured(metrics, picture, is_last=best.is_over(int(state.step), patience=setup.patience))

    how = f"{HELD_OUT}, {evaluation.sampling}" if evaluation.sampling else HELD_OUT
    return Measurement("evaluation", f"evaluation ({how})", evaluation.config.every, measure)
