"""The best evaluator of a run: kept in its folder, and the reason to stop."""

import dataclasses
import math
from pathlib import Path
from typing import Any

from t2m_jax.checkpoints.evaluator import WEIGHTS_FILE, save_evaluator_weights
from t2m_jax.config import load_config, save_config

BEST_FILE = "best.yaml"


@dataclasses.dataclass(frozen=True, kw_only=True)
class BestValidation:
    """The validation with the lowest loss so far."""

    step: int
    """Updates made by then."""
    loss: float
    """Its loss."""


class BestWeights:
    """Writes weights whenever validation was never better, and says when it has not been for long.

    A resumed run goes over some validations again and finds the same losses: what is kept is then left as it is.
    """

    def __init__(self, run: Path, *, patience: int, resume: bool):
        """Takes up a run's folder; `patience` is in updates, 0 never ends the training."""
        self._run, self._patience = run, patience
        if not resume:
            for name in (BEST_FILE, WEIGHTS_FILE):
                (run / name).unlink(missing_ok=True)
        known = (run / BEST_FILE).is_file()
        self.best = load_config(run / BEST_FILE, BestValidation) if known else BestValidation(step=0, loss=math.inf)

    def see(self, step: int, loss: float, params: Any) -> None:
        """Takes note of a validation."""
        if loss < self.best.loss:
            save_evaluator_weights(self._run, {"params": params})
            self.best = BestValidation(step=step, loss=loss)
            save_config(self._run / BEST_FILE, self.best)

    def keep_last(self, params: Any) -> None:
        """Writes weights where no validation ever chose any."""
        if not (self._run / BEST_FILE).is_file():
            save_evaluator_weights(self._run, {"params": params})

    def is_over(self, step: int) -> bool:
        """Returns whether the best is so long ago that no better is waited for."""
        return 0 < self._patience <= step - self.best.step
