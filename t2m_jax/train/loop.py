"""The one training loop."""

import logging
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from t2m_jax.checkpoints.run import Checkpoints
from t2m_jax.errors import UserError
from t2m_jax.train.config import LoopConfig
from t2m_jax.train.metric_log import MetricLog

logger = logging.getLogger(__name__)


@runtime_checkable
class TrainingState(Protocol):
    """Any `NamedTuple` that counts its updates."""

    def _asdict(self) -> dict[str, Any]: ...

    @property
    def step(self) -> Any:
        """Updates made so far."""
        ...


State = TypeVar("State", bound=TrainingState)
Metrics = Mapping[str, jax.Array]


class Look(NamedTuple):
    """What is measured on held-out data every so many updates, and at the end."""

    split: str
    """Name of its table, `<split>.csv`."""
    title: str
    """What the log calls it."""
    every: int
    measure: Callable[[Any], Mapping[str, float]]
    """From state to metrics."""


def mean_metrics(history: list[Metrics], *, first_step: int) -> dict[str, float]:
    """Returns the mean of each metric over some consecutive steps.

    Raises:
        UserError: if a loss is not finite, naming the step.
    """
    values = jax.device_get(history)
    for offset, metrics in enumerate(values):
        if not math.isfinite(metrics["loss"]):
            raise UserError(
                f"step {first_step + offset}: the loss is {metrics['loss']}; lower optimizer.learning_rate, "
                "or look at the data with `t2m data check`; checkpoints before this step are kept"
            )
    return {name: float(np.mean([metrics[name] for metrics in values])) for name in values[0]}


def mean_over_batches(measure: Callable[[jax.Array], Metrics], num_batches: int) -> dict[str, float]:
    """Returns the mean of each metric over the batches 0, 1, ... that `measure` looks at."""
    fetched = jax.device_get([measure(jnp.array(batch)) for batch in range(num_batches)])
    return {name: float(np.mean([metrics[name] for metrics in fetched])) for name in fetched[0]}


def run_loop(
    run: Path,
    state: State,
    update: Callable[[State], tuple[State, Metrics]],
    *,
    config: LoopConfig,
    validate: Callable[[State], Mapping[str, float]] | None = None,
    evaluation: Look | None = None,
    is_over: Callable[[int], bool] = lambda step: False,
) -> State:
    """Returns the state after `config.num_steps` updates, of which `state` has made some, or after fewer.

    Fewer, where `is_over` of the updates made so far says so, which is asked at the start and after looks at held-out
    data.

    Logs the mean over the steps since the last row, validates, evaluates, and writes checkpoints on the way; nothing is
    written of a state before the losses up to it were seen to be finite.

    Raises:
        UserError: on a non-finite loss, naming the step.
    """
    first_step = int(state.step)
    if is_over(first_step):
        return state
    checkpoints = Checkpoints(run, keep=config.keep_checkpoints)
    log = MetricLog(run, first_step=first_step)
    history: list[Metrics] = []
    looks = [] if validate is None else [Look("val", "validation", config.validate_every, validate)]
    looks += [] if evaluation is None else [evaluation]
    flushing = (config.log_every, config.validate_every, config.checkpoint_every)

    def due(every: int, step: int) -> bool:
        return every > 0 and (step % every == 0 or step == config.num_steps)

    try:
        with tqdm(total=config.num_steps, initial=first_step, unit="step", disable=None) as progress:
            for step in range(first_step + 1, config.num_steps + 1):
                state, metrics = update(state)
                history.append(metrics)
                looks_now = [look for look in looks if due(look.every, step)]
                if looks_now or any(due(every, step) for every in flushing):
                    means = mean_metrics(history, first_step=step - len(history) + 1)
                    log.write("train", step, means)
                    progress.update(len(history))
                    progress.set_postfix(loss=f"{means['loss']:.4f}")
                    logger.info("step %d of %d: %s", step, config.num_steps, _in_words(means))
                    history = []
                for look in looks_now:
                    scores = look.measure(state)
                    log.write(look.split, step, scores)
                    logger.info("step %d, %s: %s", step, look.title, _in_words(scores))
                ends_here = bool(looks_now) and is_over(step)
                if due(config.checkpoint_every, step) or ends_here:
                    checkpoints.save(step, state)
                if ends_here:
                    break
    finally:
        log.close()
        checkpoints.close()
    return state


def _in_words(metrics: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in metrics.items())
