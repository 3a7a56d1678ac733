"""The training loop."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import UInt8
from tqdm import tqdm

from t2m_jax.checkpoints.run import Checkpoints
from t2m_jax.errors import UserError
from t2m_jax.train.config import LoopConfig
from t2m_jax.train.log import MetricLog


@runtime_checkable
class TrainingState(Protocol):
    """Any `NamedTuple` that counts its updates in `step`."""

    def _asdict(self) -> dict[str, Any]: ...

    @property
    def step(self) -> Any:
        """Updates made so far."""


State = TypeVar("State", bound=TrainingState)
Metrics = Mapping[str, jax.Array]


class Measured(NamedTuple):
    """The result of a measurement."""

    metrics: Mapping[str, float]
    picture: UInt8[np.ndarray, "H W 3"] | None = None
    """Motions of the model."""


class Measurement(NamedTuple):
    """What is measured on held-out data every so many updates, and at the end."""

    split: str
    """Name of its table, `<split>.csv`."""
    title: str
    """Name in the log."""
    every: int
    """Updates between two measurements; 0 is never."""
    measure: Callable[[Any], Measured]
    """From a state to metrics, and to a picture if there is one."""


class Speed(NamedTuple):
    """What the log shows beside the metrics of the updates."""

    learning_rate: Callable[[int], float]
    """Of the update that makes the given number of updates complete."""
    frames_per_step: int | float


def mean_metrics(history: Sequence[Metrics], *, first_step: int) -> dict[str, float]:
    """Returns the mean of each metric over consecutive steps, the first of which is `first_step`.

    Raises:
        UserError: A loss is not finite; the message names the step.
    """
    values = jax.device_get(history)
    for offset, metrics in enumerate(values):
        if not math.isfinite(metrics["loss"]):
            raise UserError(
                f"step {first_step + offset}: the loss is {metrics['loss']}; lower optimizer.learning_rate, or check "
                "the data with `t2m data check` (checkpoints before this step are kept)"
            )
    return {name: float(np.mean([metrics[name] for metrics in values])) for name in values[0]}


def mean_over_batches(measure: Callable[[jax.Array], Metrics], num_batches: int) -> dict[str, float]:
    """Returns the mean of each metric over the batches 0, 1, ... of a data set."""
    fetched = jax.device_get([measure(jnp.array(batch)) for batch in range(num_batches)])
    return {name: float(np.mean([metrics[name] for metrics in fetched])) for name in fetched[0]}


def run_loop(
    run: Path,
    state: State,
    update: Callable[[State], tuple[State, Metrics]],
    *,
    config: LoopConfig,
    measurements: Sequence[Measurement] = (),
    speed: Speed | None = None,
    is_over: Callable[[int], bool] = lambda step: False,
) -> State:
    """Returns the state after `config.num_steps` updates, of which `state` has made some.

    The loop logs means over the updates since the last row, measures, and writes checkpoints. Nothing is written of a
    state before all losses up to it are known to be finite.

    Args:
        run: Folder of the log and the checkpoints.
        state: The state to start from; it is donated.
        update: From a state to the next state and its metrics.
        config: Length and intervals.
        measurements: What is measured on held-out data.
        speed: Learning rate and speed for the log.
        is_over: Whether training ends after this many updates; asked at the start and after measurements.

    Raises:
        UserError: A loss is not finite; the message names the step.
    """
    first_step, total = int(state.step), config.num_steps
    if is_over(first_step) or first_step >= total:
        return state
    history: list[Metrics] = []

    def due(every: int) -> bool:
        return every > 0 and (step % every == 0 or step == total)

    with (
        Checkpoints(run, keep=config.keep_checkpoints) as checkpoints,
        MetricLog(run, first_step=first_step) as log,
        tqdm(total=total, initial=first_step, unit="step", disable=None) as progress,
    ):
        for step in range(first_step + 1, total + 1):
            state, metrics = update(state)
            history.append(metrics)
            now = [measurement for measurement in measurements if due(measurement.every)]
            if now or due(config.log_every) or due(config.checkpoint_every) or step == total:
                _log_updates(log, step, history, speed, progress)
                history = []
            for measurement in now:
                _log_measurement(log, step, measurement, state)
            ends_here = bool(now) and is_over(step)
            if due(config.checkpoint_every) or ends_here or step == total:
                checkpoints.save(step, state)
            if not history:
                log.restart_clock()
            if ends_here:
                break
    return state


def _log_updates(log: MetricLog, step: int, history: list[Metrics], speed: Speed | None, progress: Any) -> None:
    means = mean_metrics(history, first_step=step - len(history) + 1)
    if speed is not None:
        means["learning_rate"] = speed.learning_rate(step)
        log.write_speed(step, steps=len(history), frames_per_step=speed.frames_per_step)
    log.write("train", step, means, title="training")
    progress.update(len(history))
    progress.set_postfix(loss=f"{means['loss']:.4f}")


def _log_measurement(log: MetricLog, step: int, measurement: Measurement, state: Any) -> None:
    found = measurement.measure(state)
    log.write(measurement.split, step, found.metrics, title=measurement.title)
    if found.picture is not None:
        log.write_picture(step, found.picture)
