"""Mean and standard deviation of motion features, stored in `Mean.npy` and `Std.npy`."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import chex
import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_array
from t2m_jax.files.writing import atomic_file
from t2m_jax.motion.namespace import AnyArray, EitherArray, namespace_of
from t2m_jax.motion.skeleton import FeatureLayout

MEAN_FILE = "Mean.npy"
STD_FILE = "Std.npy"


class Normalizer(NamedTuple):
    """Statistics of raw features, one number per column."""

    mean: Float[EitherArray, " D"]
    std: Float[EitherArray, " D"]

    def normalize(self, motion: Float[AnyArray, "*batch D"]) -> Float[AnyArray, "*batch D"]:
        """Returns normalized features, float32, of raw features."""
        mean, std, raw = self._aligned(motion)
        return (raw - mean) / std

    def denormalize(self, motion: Float[AnyArray, "*batch D"]) -> Float[AnyArray, "*batch D"]:
        """Returns raw features, float32, of normalized features."""
        mean, std, normalized = self._aligned(motion)
        return normalized * std + mean

    def _aligned(self, motion: EitherArray) -> tuple[Any, Any, Any]:
        """Returns mean, std and motion as float32 arrays of one library with equally many axes."""
        if motion.shape[-1] != self.mean.shape[-1]:
            raise UserError(
                f"motion has {motion.shape[-1]} features, but the statistics have {self.mean.shape[-1]}; "
                "use the statistics of the motion's data set"
            )
        chex.assert_shape([self.mean, self.std], (motion.shape[-1],))
        xp = namespace_of(self.mean, self.std, motion)
        # Leading axes are added by hand: tests forbid JAX to add them (`jax_numpy_rank_promotion`).
        shape = (1,) * (motion.ndim - 1) + (-1,)
        mean, std, motion = (xp.asarray(array, dtype=xp.float32) for array in (self.mean, self.std, motion))
        return mean.reshape(shape), std.reshape(shape), motion


def normalizer_from_clips(clips: Iterable[Float[np.ndarray, "_ D"]], layout: FeatureLayout) -> Normalizer:
    """Returns the statistics over all frames of `clips`. The clips are read once, one at a time.

    The standard deviation (over n) is averaged within each group of the layout, so that columns of one kind keep their
    proportions. A constant group gets 1. Clips with non-finite values are skipped.

    Raises:
        UserError: A clip does not have the layout's width, or all clips were skipped.
    """
    count = 0
    mean = np.zeros(layout.feature_dim)
    squares = np.zeros(layout.feature_dim)
    for clip in clips:
        if clip.shape[-1] != layout.feature_dim:
            raise UserError(f"a clip has {clip.shape[-1]} features, but {layout.feature_dim} are expected")
        if len(clip) == 0 or not np.isfinite(clip).all():
            continue
        frames = clip.astype(np.float64)
        # Merging means and squared deviations (Chan et al.) stays exact; sums of squares would cancel.
        clip_mean = frames.mean(0)
        total = count + len(frames)
        shift = clip_mean - mean
        squares += ((frames - clip_mean) ** 2).sum(0) + shift**2 * (count * len(frames) / total)
        mean += shift * (len(frames) / total)
        count = total
    if count == 0:
        raise UserError("there is no clip with finite features, so there are no statistics; check the data set")
    std = np.sqrt(squares / count)
    # As in the published statistics: else columns that hardly move would be as loud as the others.
    for group in layout:
        std[group] = std[group].mean() or 1.0
    return Normalizer(mean.astype(np.float32), std.astype(np.float32))


def weighted_normalizer(normalizer: Normalizer, layout: FeatureLayout, *, factor: float) -> Normalizer:
    """Returns statistics that give the root's columns and the foot contacts `factor` times their weight.

    Their standard deviations are divided by `factor`. The published evaluators were trained with a factor of 25.
    """
    weights = np.ones(layout.feature_dim, np.float32)
    for columns in (layout.root_yaw, layout.root_velocity, layout.root_height, layout.contacts):
        weights[columns] = factor
    return normalizer._replace(std=normalizer.std / weights)


def load_normalizer(folder: str | Path) -> Normalizer:
    """Returns the statistics in `Mean.npy` and `Std.npy` of a folder.

    Raises:
        UserError: See `normalizer_from_files`.
    """
    return normalizer_from_files(Path(folder) / MEAN_FILE, Path(folder) / STD_FILE)


def normalizer_from_files(mean_file: Path, std_file: Path) -> Normalizer:
    """Returns the statistics in two files.

    Raises:
        UserError: A file is missing or is not one row of finite numbers, the lengths differ, or a deviation is not
            above zero.
    """
    rows = []
    for path in (mean_file, std_file):
        with np.errstate(over="ignore"):  # numbers that are too large become infinite, which is reported below
            row = load_array(path).astype(np.float32)
        if row.ndim != 1:
            raise UserError(f"{path}: has shape {list(row.shape)}; expected one row of floating-point numbers")
        if not np.isfinite(row).all():
            raise UserError(f"{path}: column {int(np.argmin(np.isfinite(row)))} is not a finite number")
        rows.append(row)
    mean, std = rows
    if mean.shape != std.shape:
        raise UserError(f"{mean_file} has {len(mean)} columns, but {std_file.name} has {len(std)}; use one data set's")
    if not (std > 0).all():
        raise UserError(f"{std_file}: column {int(np.argmax(std <= 0))} is not above zero")
    return Normalizer(mean, std)


def save_normalizer(folder: str | Path, normalizer: Normalizer) -> None:
    """Writes `Mean.npy` and `Std.npy` into a folder. Creates the folder if it does not exist.

    Raises:
        UserError: The folder cannot be written to.
    """
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{folder}: cannot be created ({error.strerror}); choose another folder") from error
    for name, row in ((MEAN_FILE, normalizer.mean), (STD_FILE, normalizer.std)):
        with atomic_file(Path(folder) / name) as partial:
            np.save(partial, np.asarray(row, np.float32))
