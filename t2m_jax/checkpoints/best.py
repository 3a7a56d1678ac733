"""The best weights of a run. If there are any, they are loaded from the run instead of its newest checkpoint."""

import dataclasses
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from t2m_jax.checkpoints.run import Checkpoints
from t2m_jax.config import load_config, save_config
from t2m_jax.errors import UserError
from t2m_jax.files import load_arrays, save_arrays

BEST_FILE, BEST_FOLDER = "best.yaml", "best"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Best:
    """The validation or evaluation with the best figure so far."""

    step: int
    """Updates made by then."""
    metric: str
    """What the weights are chosen by: `loss` is the validation loss, other names are metrics of an evaluation."""
    value: float
    """The figure."""
    sampling: str | None = None
    """How codes were chosen in the evaluation; null if none were."""
    evaluator: str | None = None
    """Fingerprint of the evaluator, null for the validation loss. Figures of two evaluators cannot be compared."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class _BestLoss:
    """The file as the training of evaluators wrote it before version 0.2."""

    step: int
    loss: float


def find_best(run: Path) -> Best | None:
    """Returns what a run records about its best weights, None if none were chosen.

    Raises:
        UserError: The file is damaged.
    """
    path = run / BEST_FILE
    if not path.is_file():
        return None
    try:
        return load_config(path, Best)
    except UserError as error:
        try:
            old = load_config(path, _BestLoss)
        except UserError:
            raise error from None
        return Best(step=old.step, metric="loss", value=old.loss)


def save_best(run: Path, best: Best, fields: Mapping[str, Any]) -> None:
    """Writes some fields of a training state as the best weights of a run.

    The file that names the step is replaced last. A run that is killed at any moment has the new weights or the old.
    """
    path = _weights_path(run, best.step)
    path.parent.mkdir(exist_ok=True)
    save_arrays(path, fields)
    save_config(run / BEST_FILE, best)
    for other in path.parent.iterdir():
        if other != path:
            other.unlink()


def forget_best(run: Path) -> None:
    """Removes what an earlier, unfinished start in the same folder may have left."""
    (run / BEST_FILE).unlink(missing_ok=True)
    shutil.rmtree(run / BEST_FOLDER, ignore_errors=True)


def restore_trained(run: Path, like: Mapping[str, Any]) -> dict[str, Any]:
    """Returns some fields of a run's state: the best weights if any were chosen, else the newest.

    Raises:
        UserError: There is none, or it does not fit `like`.
    """
    best = find_best(run)
    if best is not None:
        return load_arrays(_weights_path(run, best.step), like)
    with Checkpoints(run) as checkpoints:
        return checkpoints.restore_fields(like)


def _weights_path(run: Path, step: int) -> Path:
    return run / BEST_FOLDER / f"{step}.safetensors"
