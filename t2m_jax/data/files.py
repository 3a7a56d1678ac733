"""The files of a data-set folder, each by itself: HumanML3D's layout, so that the real one just works.

new_joint_vecs/<id>.npy [T, D] float32, raw    new_joints/<id>.npy [T, J, 3] (optional)    texts/<id>.txt
train.txt val.txt test.txt    Mean.npy Std.npy    dataset.yaml (optional)
"""

from pathlib import Path
from tokenize import TokenError
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.data.texts import CaptionFile, read_captions
from t2m_jax.errors import UserError

FEATURES, POSITIONS, TEXTS, INFO = "new_joint_vecs", "new_joints", "texts", "dataset.yaml"
SPLITS = ("train", "val", "test")
MIRROR_PREFIX = "M"

LEAST_FRAMES = 2
"""A clip of one row has no step from one frame to the next."""


def load_array(path: Path, *, mmap: bool = False) -> np.ndarray:  # any shape: the caller checks it
    """Returns the array in a .npy file of floating-point numbers.

    Raises:
        UserError: the file is missing or damaged, or holds something else.
    """
    try:
        array = np.load(path, mmap_mode="r" if mmap else None, allow_pickle=False)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error}); is the copy complete?") from error
    except (ValueError, EOFError, TokenError) as error:  # the last from a damaged header
        raise UserError(f"{path}: is not a complete .npy file ({error}); copy or import it again") from error
    if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
        raise UserError(f"{path}: holds no floating-point numbers; expected a float32 array")
    return array


def load_features(path: Path, *, feature_dim: int) -> Float[np.ndarray, "T D"]:
    """Returns the raw features of one clip; they may hold NaN.

    Raises:
        UserError: the file is missing, is no .npy array of numbers, or has another width.
    """
    array = load_array(path)
    if array.ndim != 2 or array.shape[1] != feature_dim:
        shape = "x".join(str(size) for size in array.shape)
        raise UserError(f"{path}: has shape {shape}, expected T x {feature_dim}; is it features of another skeleton?")
    return array.astype(np.float32, copy=False)


class ClipFiles(NamedTuple):
    """A usable clip as its files have it."""

    features: Float[np.ndarray, "T D"]
    captions: CaptionFile


def clip_or_reason(folder: Path, name: str, *, feature_dim: int) -> ClipFiles | str:
    """Returns a clip, or in a few words, the same for the same fault, why nothing can use it.

    A caption line that cannot be read costs that caption only: the motion is as good as before.
    """
    motion_file, text_file = folder / FEATURES / f"{name}.npy", folder / TEXTS / f"{name}.txt"
    missing = [kind for kind, file in (("motion", motion_file), ("caption", text_file)) if not file.exists()]
    if missing:
        return f"without {' and '.join(missing)} file"
    try:
        array = load_array(motion_file)
    except UserError:
        return "with a damaged motion file"
    if array.ndim != 2:
        return f"with an array of {array.ndim} axes in place of 2"
    if array.shape[1] != feature_dim:
        return f"with {array.shape[1]} features in place of {feature_dim}"
    if len(array) < LEAST_FRAMES:
        return f"of {len(array)} frame" + "s" * (len(array) != 1)
    with np.errstate(over="ignore"):  # what is too large for 32 bits becomes infinite and is found below
        features = array.astype(np.float32, copy=False)
    if not np.all(np.isfinite(features)):
        return "with NaN or infinite values"
    try:
        return ClipFiles(features, read_captions(text_file))
    except UserError:
        return "with a damaged caption file"


def read_names(path: Path) -> tuple[str, ...]:
    """Returns the clip names of a split list, one a line, blank lines skipped.

    Raises:
        UserError: the list is missing, is not UTF-8, or a name in it would leave the folder.
    """
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except OSError as error:
        raise UserError(
            f"{path}: cannot be read ({error.strerror}); it lists the clips of the split, one a line"
        ) from error
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: is not UTF-8 text; it lists the clips of the split, one a line") from error
    for number, line in enumerate(lines, start=1):
        if "/" in line or "\\" in line:
            raise UserError(f"{path}:{number}: '{line}' is no clip name; names have no folder part")
    return tuple(line.strip() for line in lines if line.strip())
