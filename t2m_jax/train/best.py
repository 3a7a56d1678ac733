"""Keeping the best weights of a run while it trains."""

import logging
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from t2m_jax.checkpoints.best import Best, find_best, save_best
from t2m_jax.distributed import is_writer
from t2m_jax.errors import UserError

logger = logging.getLogger(__name__)


def is_better(metric: str, value: float, than: float) -> bool:
    """Returns whether one value of a metric is better than another."""
    return value > than if metric.startswith("r_precision") else value < than


class BestWeights:
    """Keeps the weights with the best value of one metric, which are then loaded from the run.

    A resumed run repeats some measurements, which do not change the weights.
    """

    def __init__(self, run: Path, *, metric: str = "loss", sampling: str | None = None, evaluator: str | None = None):
        """Continues with the best weights that are in the run's folder, if any.

        Args:
            run: Run directory.
            metric: What the weights are chosen by; `loss` is the validation loss.
            sampling: How codes are chosen, to be recorded.
            evaluator: Fingerprint of the evaluator.

        Raises:
            UserError: The best weights so far were chosen by another evaluator.
        """
        self._run, self._metric, self._sampling, self._evaluator = run, metric, sampling, evaluator
        self.best = find_best(run)
        if self.best is not None and self.best.evaluator != evaluator:
            raise UserError(
                f"{run}: was started with evaluator {self.best.evaluator}, not {evaluator}; figures of two evaluators "
                "cannot be compared"
            )

    def consider(self, step: int, figures: Mapping[str, float], fields: Mapping[str, Any]) -> None:
        """Keeps the weights (fields of a training state) if they are the best so far."""
        if self.best is not None and step == self.best.step:
            return  # measured again by a resumed run; a GPU may round the figure otherwise
        value = figures[self._metric]
        # Nothing compares as better than NaN: as the first value it would stay the best.
        if math.isfinite(value) and (self.best is None or is_better(self._metric, value, self.best.value)):
            self.best = Best(
                step=step, metric=self._metric, value=value, sampling=self._sampling, evaluator=self._evaluator
            )
            if is_writer():
                save_best(self._run, self.best, fields)
            logger.info("step %d: best %s so far, these weights are kept", step, self._metric)

    def is_over(self, step: int, *, patience: int) -> bool:
        """Returns whether the best weights are at least `patience` updates old; never if `patience` is 0."""
        best = find_best(self._run) if patience else None  # of a process that does not measure, another wrote it
        return best is not None and patience <= step - best.step
