"""NumPy archives, which keep everything that a `Motion` has."""

import sys
from collections.abc import Sequence
from io import BufferedIOBase
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.export.writing import only_motion
from t2m_jax.files import atomic_file, load_archive
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D, skeleton_from_name


class _Entry(NamedTuple):
    """What an entry of an archive must be: letters of `dtype.kind`, possible numbers of axes, and both in words."""

    kinds: str
    ndims: tuple[int, ...]
    description: str


REQUIRED_KEYS = ("positions", "fps")
ENTRIES = {
    "positions": _Entry("f", (3,), "real numbers [frames, joints, 3]"),
    "fps": _Entry("fiu", (0,), "one number"),
    "positions_raw": _Entry("f", (3,), "real numbers [frames, joints, 3]"),
    "features": _Entry("f", (2,), "real numbers [frames, features]"),
    "codes": _Entry("iu", (1, 2), "whole numbers [codes] or [codes, layers]"),
    "caption": _Entry("U", (0,), "one text"),
    "seed": _Entry("iu", (0,), "one whole number"),
    "skeleton": _Entry("U", (0,), "one text"),
    "warning": _Entry("U", (0,), "one text"),
    "unknown_words": _Entry("U", (1,), "texts"),
    "part_starts": _Entry("iu", (1,), "whole numbers"),
    "part_captions": _Entry("U", (1,), "texts"),
}
TUPLES = ("unknown_words", "part_starts", "part_captions")


def save_npz(path: Path, motions: Sequence[Motion]) -> None:
    """Writes one motion as an archive with the keys of `ENTRIES`. None and empty warnings are left out."""
    motion = only_motion(path, motions)
    with atomic_file(path) as partial, partial.open("wb") as file:
        write_npz(file, motion)


def write_npz(file: BufferedIOBase, motion: Motion, *, compress: bool = True) -> None:
    """Writes the archive of one motion; without compression it is faster and has twice the size."""
    values = {key: getattr(motion, key) for key in ENTRIES} | {"skeleton": motion.skeleton.name}
    values |= {key: values[key] or None for key in ("warning", *TUPLES)}
    if motion.codes is not None and motion.codes.shape[1:] == (1,):
        values["codes"] = motion.codes[:, 0]  # other programs expect the codes of T2M-GPT without a layer axis
    save = np.savez_compressed if compress else np.savez
    save(file, **{key: value for key, value in values.items() if value is not None})


def load_npz(path: str | Path) -> Motion:
    """Returns the motion of an archive that `save_npz`, or another program with the same keys, wrote.

    Raises:
        UserError: The file is not such an archive. The message names the entry.
    """
    path = Path(path)
    archive = load_archive(path)
    for key in REQUIRED_KEYS:
        if key not in archive:
            raise UserError(f"{path}: there is no entry {key!r}; a motion has at least {', '.join(REQUIRED_KEYS)}")
    for key, value in archive.items():
        if key not in ENTRIES:
            raise UserError(f"{path}: unknown entry {key!r}; a motion has {', '.join(ENTRIES)}")
        kinds, ndims, description = ENTRIES[key]
        if value.dtype.kind not in kinds or value.ndim not in ndims:
            raise UserError(f"{path}: entry {key!r} should hold {description}, not {value.dtype} {value.shape}")
    for key, value in archive.items():
        # NumPy makes texts of numbers that are no characters; CPython fails when it uses them.
        if value.dtype.kind == "U" and _largest_character(value) > sys.maxunicode:
            raise UserError(f"{path}: entry {key!r} has numbers that are no characters")
    fields: dict[str, Any] = {key: value if value.ndim else value.item() for key, value in archive.items()}
    fields |= {key: tuple(archive[key].tolist()) for key in TUPLES if key in archive}
    if "codes" in archive and archive["codes"].ndim == 1:
        fields["codes"] = archive["codes"][:, None]
    try:
        return Motion(**fields | {"skeleton": skeleton_from_name(fields.get("skeleton", HUMANML3D.name))})
    except UserError as error:
        raise UserError(f"{path}: {error}") from error


def _largest_character(texts: np.ndarray) -> int:
    native = texts.astype(texts.dtype.newbyteorder("="))
    return int(np.frombuffer(native.tobytes(), np.uint32).max(initial=0))
