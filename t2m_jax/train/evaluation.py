"""Evaluation on the way: its figures in a table of the run, and the weights that were best by one of them."""

import logging
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from t2m_jax.checkpoints.best import Best, Sampling, find_best, forget_best, save_best
from t2m_jax.data.folder import Dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.monitor import SPLIT, open_held_out
from t2m_jax.evaluation.task import Subject
from t2m_jax.train.config import EvaluationConfig
from t2m_jax.train.loop import Look

logger = logging.getLogger(__name__)

Fields = Mapping[str, Any]
"""Fields of a training state, by name."""


def open_evaluation(config: EvaluationConfig, dataset: Dataset) -> Subject | None:
    """Returns what a run is evaluated on, None where it is not to be evaluated.

    Raises:
        UserError: if the evaluator is missing or does not fit the data, or the validation split is too small.
    """
    return None if config.evaluator is None else open_held_out(dataset, config.evaluator, seed=config.seed)


def is_better(metric: str, value: float, than: float) -> bool:
    """Returns whether a figure beats another."""
    return value > than if metric.startswith("r_precision") else value < than


class BestByMetric:
    """Keeps the weights with the best figure so far; the run then stands for them.

    A resumed run goes over some evaluations again and finds the same figures: what is kept is then left as it is.
    """

    def __init__(self, run: Path, *, metric: str, sampling: Sampling | None, evaluator: str, resume: bool):
        """Takes up a run's folder; `evaluator` is a fingerprint.

        Raises:
            UserError: if another evaluator has chosen in this run so far.
        """
        if not resume:
            forget_best(run)
        self._run, self._metric, self._sampling, self._evaluator = run, metric, sampling, evaluator
        self.best = find_best(run)
        if self.best is not None and self.best.evaluator != evaluator:
            raise UserError(
                f"{run}: was started with evaluator {self.best.evaluator}, not {evaluator}; figures of two evaluators "
                "do not compare"
            )

    def see(self, step: int, figures: Mapping[str, float], fields: Fields) -> None:
        """Takes note of an evaluation, and keeps the weights where it is the best so far."""
        value = figures[self._metric]
        if math.isfinite(value) and (self.best is None or is_better(self._metric, value, self.best.value)):
            self.best = Best(
                step=step, metric=self._metric, value=value, sampling=self._sampling, evaluator=self._evaluator
            )
            save_best(self._run, self.best, fields)
            logger.info("step %d: best %s so far; these weights are kept", step, self._metric)


def make_evaluation(
    run: Path,
    config: EvaluationConfig,
    *,
    evaluator: str,
    evaluate: Callable[[Any], Mapping[str, float]],
    trained: Callable[[Any], Fields],
    sampling: Sampling | None,
    resume: bool,
) -> Look:
    """Returns what the training loop does every `config.every` updates.

    Args:
        run: Run directory.
        config: How often, and what is chosen by.
        evaluator: Fingerprint of the evaluator.
        evaluate: From training state to figures.
        trained: From training state to the fields that are weights.
        sampling: How codes are chosen, to be said with the figures; None where none are.
        resume: Whether the run goes on.

    Raises:
        UserError: if another evaluator has chosen in this run so far.
    """
    best = BestByMetric(run, metric=config.metric, sampling=sampling, evaluator=evaluator, resume=resume)

    def measure(state: Any) -> Mapping[str, float]:
        figures = evaluate(state)
        best.see(int(state.step), figures, trained(state))
        return figures

    how = f"{SPLIT}, {sampling}" if sampling else SPLIT
    return Look("evaluation", f"evaluation ({how})", config.every, measure)
