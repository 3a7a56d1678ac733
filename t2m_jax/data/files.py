"""The single files of a data-set folder.

The layout is that of HumanML3D, so that the original data set is read without an import:

new_joint_vecs/<id>.npy [T, D] float32, raw    new_joints/<id>.npy [T, J, 3] (optional)    texts/<id>.txt
train.txt val.txt test.txt    Mean.npy Std.npy    dataset.yaml (optional)    index.csv (optional)
"""

import unicodedata
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.data.texts import CaptionFile, read_captions
from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_array, load_text

FEATURES = "new_joint_vecs"
POSITIONS = "new_joints"
TEXTS = "texts"
INFO = "dataset.yaml"
SPLITS = ("train", "val", "test")
MIRROR_PREFIX = "M"

MAX_NAME = 240
"""Bytes of a clip's name; file systems allow 255 with the suffix and what is added while a file is written."""
MIN_FRAMES = 2
"""Fewest frames of a usable clip: with one there is no step from one frame to the next."""


class ClipFiles(NamedTuple):
    """The contents of the files of a usable clip."""

    features: Float[np.ndarray, "T D"]
    captions: CaptionFile


def clip_or_reason(folder: Path, name: str, *, feature_dim: int) -> ClipFiles | str:
    """Returns a clip, or the reason why it cannot be used.

    The reasons are short and the same for the same fault, so that clips can be counted by reason. A caption line that
    cannot be read is not a reason: only that caption is lost.
    """
    motion_file = folder / FEATURES / f"{name}.npy"
    text_file = folder / TEXTS / f"{name}.txt"
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
    if len(array) < MIN_FRAMES:
        return f"of {len(array)} frame" + "s" * (len(array) != 1)
    with np.errstate(over="ignore"):  # a value that is too large for 32 bits becomes infinite and is found below
        features = array.astype(np.float32, copy=False)
    if not np.all(np.isfinite(features)):
        return "with NaN or infinite values"
    try:
        return ClipFiles(features, read_captions(text_file))
    except UserError:
        return "with a damaged caption file"


def read_names(path: Path) -> tuple[str, ...]:
    """Returns the clip names in a split list: one per line, without blank lines.

    Raises:
        UserError: The list is missing or is not UTF-8, or a name in it points to another folder, is too long or has
            control characters.
    """
    names = [line.strip() for line in load_text(path).split("\n")]
    for number, name in enumerate(names, start=1):
        # Lists come from strangers, too, and a name with a folder would read a file outside of the data set.
        if "/" in name or "\\" in name:
            raise UserError(f"{path}:{number}: '{name}' is not a clip name; remove the folder from it")
        if any(unicodedata.category(character) == "Cc" for character in name):
            raise UserError(f"{path}:{number}: '{name}' is not a clip name; remove the control characters from it")
        if len(name.encode()) > MAX_NAME:
            raise UserError(f"{path}:{number}: '{name}' is not a clip name; it has more than {MAX_NAME} bytes")
    return tuple(filter(None, names))
