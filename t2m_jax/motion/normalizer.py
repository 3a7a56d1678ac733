"""Mean and standard deviation of motion features: measured, applied, kept in `Mean.npy` and `Std.npy`."""

from collections.abc import Iterable
from pathlib import Path
from tokenize import TokenError
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.layout import FeatureLayout
from t2m_jax.motion.namespace import AnyArray, EitherArray, namespace_of

_MEAN_FILE, _STD_FILE = "Mean.npy", "Std.npy"

_DAMAGED = (OSError, ValueError, EOFError, TokenError, SyntaxError, TypeError, OverflowError, MemoryError)
"""What NumPy raises on damaged files: it believes their headers, and reads those as Python."""


class Normalizer(NamedTuple):
    """Statistics of raw features, one number a column."""

    mean: Float[EitherArray, " D"]
    std: Float[EitherArray, " D"]

    def normalize(self, motion: Float[AnyArray, "*batch D"]) -> Float[AnyArray, "*batch D"]:
        """Returns raw features normalized, in float32."""
        mean, std, raw = self._aligned(motion)
        return (raw - mean) / std

    def denormalize(self, motion: Float[AnyArray, "*batch D"]) -> Float[AnyArray, "*batch D"]:
        """Returns normalized features raw, in float32."""
        mean, std, normalized = self._aligned(motion)
        return normalized * std + mean

    def _aligned(self, motion: EitherArray) -> tuple[Any, Any, Any]:
        """Returns mean, std and motion as float32 arrays of one library and equally many axes."""
        if motion.shape[-1] != self.mean.shape[-1]:
            raise UserError(
                f"motion has {motion.shape[-1]} features, but the statistics have {self.mean.shape[-1]}; "
                "use the statistics of the data set the motion belongs to"
            )
        xp = namespace_of(self.mean, self.std, motion)
        shape = (1,) * (motion.ndim - 1) + (-1,)
        mean, std, motion = (xp.asarray(array, dtype=xp.float32) for array in (self.mean, self.std, motion))
        return mean.reshape(shape), std.reshape(shape), motion


def normalizer_from_clips(clips: Iterable[Float[np.ndarray, "_ D"]], layout: FeatureLayout) -> Normalizer:
    """Returns the statistics over all frames of `clips`, which are read once, one at a time.

    The standard deviation (over n) is averaged inside each group of the layout, so that columns of one kind keep their
    proportions; a group that never changes gets 1. Clips with a value that is not finite are left out.

    Raises:
        UserError: A clip has another width than the layout, or no clip is left.
    """
    count, mean, squares = 0, np.zeros(layout.feature_dim), np.zeros(layout.feature_dim)
    for clip in clips:
        if clip.shape[-1] != layout.feature_dim:
            raise UserError(f"a clip has {clip.shape[-1]} features where {layout.feature_dim} are expected")
        if len(clip) == 0 or not np.isfinite(clip).all():
            continue
        frames = clip.astype(np.float64)
        # Merging means and squared deviations (Chan et al.) stays exact where sums of squares would cancel.
        clip_mean, total = frames.mean(0), count + len(frames)
        shift = clip_mean - mean
        squares += ((frames - clip_mean) ** 2).sum(0) + shift**2 * (count * len(frames) / total)
        mean += shift * (len(frames) / total)
        count = total
    if count == 0:
        raise UserError("no clip with finite features to measure statistics on")
    std = np.sqrt(squares / count)
    for group in layout.groups:
        std[group] = std[group].mean() or 1.0
    return Normalizer(mean.astype(np.float32), std.astype(np.float32))


def weighted_normalizer(normalizer: Normalizer, layout: FeatureLayout, *, factor: float) -> Normalizer:
    """Returns statistics under which the root's columns and the contacts weigh `factor` times as much.

    Their standard deviations are divided by `factor`; published evaluators were trained with 25.
    """
    weights = np.ones(layout.feature_dim, np.float32)
    for columns in (layout.root_yaw, layout.root_velocity, layout.root_height, layout.contacts):
        weights[columns] = factor
    return normalizer._replace(std=normalizer.std / weights)


def load_normalizer(folder: str | Path) -> Normalizer:
    """Returns the statistics kept in `Mean.npy` and `Std.npy` of a folder.

    Raises:
        UserError: A file is missing or no array, the two do not fit together, or a deviation is not above zero.
    """
    return normalizer_from_files(Path(folder) / _MEAN_FILE, Path(folder) / _STD_FILE)


def normalizer_from_files(mean_file: Path, std_file: Path) -> Normalizer:
    """Returns the statistics kept in two files.

    Raises:
        UserError: A file is missing or no array, the two do not fit together, or a deviation is not above zero.
    """
    mean, std = _load_statistics(mean_file), _load_statistics(std_file)
    if mean.shape != std.shape:
        raise UserError(f"{mean_file} has {len(mean)} columns and {std_file.name} has {len(std)}")
    if not (std > 0).all():
        raise UserError(f"{std_file}: column {int(np.argmax(std <= 0))} is not above zero")
    return Normalizer(mean, std)


def _load_statistics(path: Path) -> Float[np.ndarray, " D"]:
    """Returns one row of finite numbers from a file."""
    try:
        values = np.load(path)
    except FileNotFoundError as error:
        raise UserError(f"{path}: missing; a data set keeps its statistics there") from error
    except _DAMAGED as error:
        raise UserError(f"{path}: cannot be read as a NumPy array") from error
    if not isinstance(values, np.ndarray) or values.ndim != 1 or values.dtype.kind != "f":
        raise UserError(f"{path}: expected one row of floating-point numbers")
    if not np.isfinite(values).all():
        raise UserError(f"{path}: column {int(np.argmin(np.isfinite(values)))} is not a finite number")
    return values.astype(np.float32)


def save_normalizer(folder: str | Path, normalizer: Normalizer) -> None:
    """Writes `Mean.npy` and `Std.npy` into a folder, which is made if need be.

    Raises:
        UserError: The folder cannot be written to.
    """
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        np.save(Path(folder) / _MEAN_FILE, np.asarray(normalizer.mean, np.float32))
        np.save(Path(folder) / _STD_FILE, np.asarray(normalizer.std, np.float32))
    except OSError as error:
        raise UserError(f"{folder}: statistics cannot be written here ({error.strerror})") from error
