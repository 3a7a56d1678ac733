"""The best weights of a run: where evaluation chose some, the run stands for them, not for its newest checkpoint."""

import dataclasses
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from t2m_jax.checkpoints.run import Checkpoints
from t2m_jax.config import load_config, save_config
from t2m_jax.files import load_arrays, save_arrays

BEST_FILE, BEST_FOLDER = "best.yaml", "best"

Sampling = Literal["greedy", "sampled"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Best:
    """The evaluation with the best figure so far."""

    step: int
    """Updates made by then."""
    metric: str
    """By which it is the best."""
    value: float
    """Its figure."""
    sampling: Sampling | None
    """How codes were chosen; null for a VQ-VAE, which chooses none."""
    evaluator: str
    """Fingerprint of the evaluator; figures of two evaluators do not compare."""


def find_best(run: Path) -> Best | None:
    """Returns what a run says of its best weights, None where no evaluation chose any.

    Raises:
        UserError: if the file that says it is damaged.
    """
    path = run / BEST_FILE
    return load_config(path, Best) if path.is_file() else None


def save_best(run: Path, best: Best, fields: Mapping[str, Any]) -> None:
    """Writes some fields of a training state as the best of a run.

    The file that names the step is replaced last, so that a run killed at any moment has either these weights or those
    of before.
    """
    path = _weights_path(run, best.step)
    path.parent.mkdir(exist_ok=True)
    partial = path.with_suffix(".partial")
    save_arrays(partial, fields)
    partial.chmod(0o644)  # safetensors makes them private
    os.replace(partial, path)
    save_config(run / BEST_FILE, best)
    for other in path.parent.iterdir():
        if other != path:
            other.unlink()


def forget_best(run: Path) -> None:
    """Removes what an earlier start in the same folder may have left."""
    (run / BEST_FILE).unlink(missing_ok=True)
    shutil.rmtree(run / BEST_FOLDER, ignore_errors=True)


def restore_trained(run: Path, like: Mapping[str, Any]) -> dict[str, Any]:
    """Returns some fields of the state a run stands for: the best, where evaluation chose one, else the newest.

    Raises:
        UserError: if there is none, or it does not fit `like`.
    """
    best = find_best(run)
    if best is not None:
        return load_arrays(_weights_path(run, best.step), like)
    checkpoints = Checkpoints(run)
    try:
        return checkpoints.restore_fields(like)
    finally:
        checkpoints.close()


def _weights_path(run: Path, step: int) -> Path:
    return run / BEST_FOLDER / f"{step}.safetensors"
