"""The best weights of a run. If there are any, they are loaded from the run instead of its newest checkpoint."""

import contextlib
import dataclasses
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from t2m_jax.checkpoints.run import Checkpoints
from t2m_jax.config import load_config, save_config
from t2m_jax.files.arrays import load_arrays, save_arrays
from t2m_jax.files.manifest import check_folder, write_manifest
from t2m_jax.files.writing import atomic_folder

BEST_FILE = "best.yaml"
BEST_FOLDER = "best"
WEIGHTS_FILE = "weights.safetensors"


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


def find_best(run: Path) -> Best | None:
    """Returns what a run records about its best weights, None if none were chosen.

    Raises:
        UserError: The file is damaged.
    """
    folder = _newest(run)
    if folder is None:
        return None
    # The weights are large. They are checked when they are loaded.
    check_folder(folder, only=(BEST_FILE,))
    return load_config(folder / BEST_FILE, Best)


def save_best(run: Path, best: Best, fields: Mapping[str, Any]) -> None:
    """Writes some fields of a training state as the best weights of a run.

    They are in a folder with a manifest, which appears complete. A run that is killed at any moment has the new weights
    or the old.
    """
    # A new folder each time: weights and figures must change together, and a folder with files cannot be replaced in
    # one step.
    folder = run / BEST_FOLDER / f"{best.step}"
    with atomic_folder(folder) as partial:
        save_arrays(partial / WEIGHTS_FILE, fields)
        save_config(partial / BEST_FILE, best)
        write_manifest(partial)
    # What cannot be deleted now does no harm, and goes with the next best weights.
    with contextlib.suppress(OSError):
        for other in folder.parent.iterdir():
            if other != folder:
                shutil.rmtree(other) if other.is_dir() else other.unlink()


def restore_trained(run: Path, like: Mapping[str, Any]) -> dict[str, Any]:
    """Returns some fields of a run's state: the best weights if any were chosen, else the newest.

    Raises:
        UserError: There is none, it is damaged, or it does not fit `like`.
    """
    folder = _newest(run)
    if folder is not None:
        check_folder(folder)
        return load_arrays(folder / WEIGHTS_FILE, like)
    with Checkpoints(run) as checkpoints:
        return checkpoints.restore_fields(like)


def _newest(run: Path) -> Path | None:
    """Returns the folder of the best weights; after a kill, the older ones may be there, too."""
    folders = [path for path in (run / BEST_FOLDER).glob("*") if path.is_dir() and path.name.isdecimal()]
    return max(folders, key=lambda path: int(path.name), default=None)
