"""The training loop, and the signals that end it after the next update, so that no update is lost."""

import contextlib
import math
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.experimental import multihost_utils
from jaxtyping import UInt8
from tqdm import tqdm

from t2m_jax.checkpoints.run import Checkpoints
from t2m_jax.distributed import is_writer
from t2m_jax.errors import ENDING_SIGNALS, Interruption, UserError, handling_signals
from t2m_jax.train.config import LoopConfig
from t2m_jax.train.log import MetricLog

MOST_CALLS = 1000
"""Calls after which their metrics go to the host: on a device, each takes kilobytes."""
Metrics = Mapping[str, jax.Array]


class Measured(NamedTuple):
    """The result of a measurement."""

    metrics: Mapping[str, float]
    picture: UInt8[np.ndarray, "H W 3"] | None = None
    """Motions of the model."""
    is_last: bool = False
    """Whether training ends here, because more updates make the model no better."""


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
    """What the log shows besides the metrics of the updates."""

    learning_rate: Callable[[int], float]
    """Of the update that makes the given number of updates complete."""
    frames_per_step: int | float


class Call(NamedTuple):
    """The updates of one call."""

    metrics: Mapping[str, Any]
    """Of each update, in arrays that may have more rows."""
    updates: int
    """Number of updates."""


def join_calls(calls: Sequence[Call]) -> Call:
    """Returns one call that has the updates of several, with its metrics on the host."""
    # One transfer for all calls: the host does not wait for each update.
    fetched = [(jax.device_get(call.metrics), call.updates) for call in calls]
    metrics = {name: np.concatenate([found[name][:count] for found, count in fetched]) for name in fetched[0][0]}
    return Call(metrics, sum(call.updates for call in calls))


def add_call(calls: list[Call], call: Call) -> None:
    """Adds a call to a list, of which all become one if there are too many."""
    calls.append(call)
    if len(calls) > MOST_CALLS:
        calls[:] = [join_calls(calls)]


def mean_metrics(calls: Sequence[Call], *, first_step: int) -> dict[str, float]:
    """Returns the mean of each metric over consecutive steps, the first of which is `first_step`.

    Raises:
        UserError: A loss is not finite; the message names the step.
    """
    values = join_calls(calls).metrics
    # Of every step and not of the mean, so that the message can name the first one.
    for step, loss in enumerate(values["loss"], start=first_step):
        if not math.isfinite(loss):
            raise UserError(
                f"step {step}: the loss is {loss}; lower optimizer.learning_rate, or check the data with "
                "`t2m data check` (checkpoints before this step are kept)"
            )
    return {name: float(np.mean(rows)) for name, rows in values.items()}


def mean_over_batches(measure: Callable[[Any], Metrics], num_batches: int) -> dict[str, float]:
    """Returns the mean of each metric over the batches 0, 1, ... of a data set."""
    # Nothing is fetched before the end, so that the devices need not wait between batches.
    fetched = jax.device_get([measure(np.int32(batch)) for batch in range(num_batches)])
    return {name: float(np.mean([metrics[name] for metrics in fetched])) for name in fetched[0]}


def run_loop(
    run: Path,
    state: Any,
    update: Callable[[Any, int], tuple[Any, Metrics]],
    *,
    config: LoopConfig,
    measurements: Sequence[Measurement] = (),
    speed: Speed | None = None,
    asked_to_stop: Callable[[int], int | None] = lambda step: None,
) -> Any:
    """Returns the state after `config.num_steps` updates, of which `state` has made some.

    The loop logs means over the updates since the last row, measures, and writes checkpoints. Nothing is written of a
    state before all losses up to it are known to be finite.

    Args:
        run: Folder of the log and the checkpoints.
        state: The state to start from, a `NamedTuple` that counts its updates in `step`; it is donated.
        update: From a state and a number of updates, up to `config.steps_per_call`, to the state after them and the
            metrics of each in arrays.
        config: Length and intervals.
        measurements: What is measured on held-out data.
        speed: Learning rate and speed for the log.
        asked_to_stop: The number of the signal that asked to stop, None if there was none; asked after each call.

    Raises:
        UserError: A loss is not finite; the message names the step.
        Interruption: A signal asked to stop; the state of that moment is the newest checkpoint.
    """
    step = int(state.step)
    total = config.num_steps
    if step >= total:
        return state
    calls: list[Call] = []
    is_over = False
    with (
        Checkpoints(run, keep=config.keep_checkpoints) as checkpoints,
        MetricLog(run, first_step=step) as log,
        tqdm(total=total, initial=step, unit="step", disable=None if is_writer() else True) as progress,
    ):
        while step < total and not is_over:
            count = next_count(step, config, measurements)
            state, metrics = update(state, count)
            step += count
            add_call(calls, Call(metrics, count))
            asked = asked_to_stop(step)
            due = [one for one in measurements if is_due(step, one.every, last=total)]
            is_kept = asked is not None or step == total or is_due(step, config.checkpoint_every, last=total)
            if due or is_kept or is_due(step, config.log_every, last=total):  # first: it raises if a loss is not finite
                _log_updates(log, step, calls, speed, progress)
                calls = []
            is_over = _log_measurements(log, step, due, state) or asked is not None
            if is_kept or is_over:
                checkpoints.save(step, state)
            if not calls:
                log.restart_clock()  # the time of measurements and checkpoints is not that of updates
    if asked is not None and step < total:
        raise _interruption(run, asked, step)
    return state


def _interruption(run: Path, number: int, step: int) -> Interruption:
    name = signal.Signals(number).name
    return Interruption(number, f"{run}: stopped by {name} after step {step}, which is kept; add --resume to continue")


def next_count(step: int, config: LoopConfig, measurements: Sequence[Measurement]) -> int:
    """Returns the number of updates of the call after `step`: nothing is due before its end."""
    intervals = (config.log_every, config.checkpoint_every, *(measurement.every for measurement in measurements))
    # A call ends where something is due. A row of the log is always that of a whole number of calls.
    until_due = (next_multiple(step, every, limit=config.num_steps) - step for every in intervals)
    return min(config.steps_per_call, *until_due)


def next_multiple(step: int, every: int, *, limit: int) -> int:
    """Returns the next step after `step` that is a multiple of `every`, or `limit` if that is sooner or never."""
    return limit if every == 0 else min((step // every + 1) * every, limit)


def is_due(step: int, every: int, *, last: int) -> bool:
    """Returns whether something is done after `step`: after each `every` steps and the last; never if `every` is 0.

    This depends on the step alone, so a resumed run writes the same lines as another.
    """
    return every > 0 and (step % every == 0 or step == last)


def _log_updates(log: MetricLog, step: int, calls: list[Call], speed: Speed | None, progress: Any) -> None:
    count = sum(call.updates for call in calls)
    means = mean_metrics(calls, first_step=step - count + 1)
    if speed is not None:
        means["learning_rate"] = speed.learning_rate(step)
        log.write_speed(step, steps=count, frames_per_step=speed.frames_per_step)
    log.write("train", step, means, title="training")
    progress.update(count)
    progress.set_postfix(loss=f"{means['loss']:.4f}")


def _log_measurements(log: MetricLog, step: int, measurements: Sequence[Measurement], state: Any) -> bool:
    """Logs what is measured after a step, and returns whether a measurement ends the training."""
    is_last = False
    for measurement in measurements:
        found = measurement.measure(state)
        log.write(measurement.split, step, found.metrics, title=measurement.title)
        if found.picture is not None:
            log.write_picture(step, found.picture)
        is_last = is_last or found.is_last
    return is_last


@contextlib.contextmanager
def stop_requests() -> Iterator[Callable[[int], int | None]]:
    """Yields a function that says, after an update, whether a signal asked to stop.

    From the number of updates, it returns the number of the signal, or None. If several processes train together, it
    gives all of them the same answer after the same update. A second Ctrl-C interrupts at once.
    """
    found: list[int] = []

    def remember(number: int, _: FrameType | None) -> None:
        if number == signal.SIGINT and found:
            raise KeyboardInterrupt
        found.append(number)

    def pass_on(number: int, _: FrameType | None) -> None:
        os.kill(os.getpid(), signal.SIGTERM)

    several = jax.process_count() > 1
    # With several processes, JAX has a handler of SIGTERM of its own, through which they agree on a step.
    handlers = {"SIGUSR1": pass_on} if several else dict.fromkeys(ENDING_SIGNALS, remember)

    def asked(step: int) -> int | None:
        if several:
            return signal.SIGTERM if multihost_utils.reached_preemption_sync_point(step) else None
        return found[0] if found else None

    with handling_signals(handlers):
        yield asked
