"""NumPy archives, which keep everything that a `Motion` has; a motion of any length can be written piece by piece."""

import contextlib
import sys
import tempfile
from collections.abc import Iterable, Sequence
from io import BufferedIOBase
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np

from t2m_jax.errors import UserError, naming
from t2m_jax.export.amass import amass_arrays, motion_from_amass
from t2m_jax.export.formats import only_motion
from t2m_jax.files.reading import load_archive
from t2m_jax.files.writing import atomic_file
from t2m_jax.motion.amass import ROTATIONS, is_amass
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D, skeleton_from_name

REQUIRED_KEYS = ("positions", "fps")
ENTRIES: dict[str, tuple[str, tuple[int, ...], str]] = {
    "positions": ("f", (3,), "real numbers [frames, joints, 3]"),
    "fps": ("fiu", (0,), "one number"),
    "positions_raw": ("f", (3,), "real numbers [frames, joints, 3]"),
    "features": ("f", (2,), "real numbers [frames, features]"),
    "codes": ("iu", (1, 2), "whole numbers [codes] or [codes, layers]"),
    "caption": ("U", (0,), "one text"),
    "seed": ("iu", (0,), "one whole number"),
    "skeleton": ("U", (0,), "one text"),
    "warning": ("U", (0,), "one text"),
    "unknown_words": ("U", (1,), "texts"),
    "part_starts": ("iu", (1,), "whole numbers"),
    "part_captions": ("U", (1,), "texts"),
}
"""What an entry of an archive must be: letters of `dtype.kind`, possible numbers of axes, and both in words."""
TUPLES = ("unknown_words", "part_starts", "part_captions")
GROWING = ("positions", "features", "codes")
"""Entries that grow with the motion."""


def save_npz(path: Path, motions: Sequence[Motion], *, names: Literal["humanml3d", "smpl"] = "humanml3d") -> None:
    """Writes one motion as an archive with the keys of `ENTRIES`. None and empty warnings are left out.

    Args:
        path: The file.
        motions: One motion.
        names: "smpl" writes the keys of AMASS instead: rotations of the body model SMPL (see `amass_arrays`).

    Raises:
        UserError: There is not exactly one motion, or SMPL has not its joints.
    """
    motion = only_motion(path, motions)
    with atomic_file(path) as partial, partial.open("wb") as file:
        if names == "smpl":
            np.savez_compressed(file, **amass_arrays(path, motion))
        else:
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
    """Returns the motion of an archive that `save_npz`, or another program with the same keys, wrote; or of AMASS.

    Raises:
        UserError: The file is not such an archive. The message names the entry.
    """
    path = Path(path)
    archive = load_archive(path)
    if is_amass(archive.keys()):
        return motion_from_amass(path, archive)
    for key in REQUIRED_KEYS:
        if key not in archive:
            others = " or ".join(" and ".join(names) for names in ROTATIONS)
            least = f"a motion has at least {', '.join(REQUIRED_KEYS)}; rotations of SMPL are {others}"
            raise UserError(f"{path}: there is no entry {key!r}; {least}")
    for key, value in archive.items():
        if key not in ENTRIES:
            raise UserError(f"{path}: unknown entry {key!r}; a motion has {', '.join(ENTRIES)}")
        kinds, ndims, description = ENTRIES[key]
        if value.dtype.kind not in kinds or value.ndim not in ndims:
            raise UserError(f"{path}: entry {key!r} should hold {description}, not {value.dtype} {value.shape}")
        # NumPy makes texts of numbers that are no characters; CPython fails when it uses them.
        if value.dtype.kind == "U":
            native = value.astype(value.dtype.newbyteorder("="))
            if np.frombuffer(native.tobytes(), np.uint32).max(initial=0) > sys.maxunicode:
                raise UserError(f"{path}: entry {key!r} has numbers that are no characters")
    fields: dict[str, Any] = {key: value if value.ndim else value.item() for key, value in archive.items()}
    fields |= {key: tuple(archive[key].tolist()) for key in TUPLES if key in archive}
    if "codes" in archive and archive["codes"].ndim == 1:
        fields["codes"] = archive["codes"][:, None]
    with naming(path):
        motion = Motion(**fields | {"skeleton": skeleton_from_name(fields.get("skeleton", HUMANML3D.name))})
    return motion  # noqa: RET504 - for mypy, a `return` inside `with` may not be reached


def save_pieces(path: str | Path, pieces: Iterable[Motion]) -> int:
    """Writes the pieces of one motion, such as those of `TextToMotion.stream_chain`, as one `.npz` file.

    It is the file of the whole motion, which is never in memory, with `part_starts` and `part_captions`.

    Returns:
        The number of frames.

    Raises:
        UserError: There are no pieces, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix != ".npz":
        raise UserError(f"{path}: pieces of a motion are written to .npz files only")
    with atomic_file(path) as partial, contextlib.ExitStack() as stack:
        # They have no names, so nothing is left of them if the process is killed.
        grown = {key: stack.enter_context(tempfile.TemporaryFile(dir=path.absolute().parent)) for key in GROWING}
        first: Motion | None = None
        starts: list[int] = []
        captions: list[str] = []
        frames = 0
        for piece in pieces:
            first = first or piece
            starts += [frames + start for start in piece.part_starts]
            captions += piece.part_captions
            frames += piece.num_frames
            # Only the bytes: `np.save` would need the final length in its header.
            for key in GROWING:
                if getattr(piece, key) is not None:
                    grown[key].write(np.ascontiguousarray(getattr(piece, key)).data)
        if first is None:
            raise UserError(f"{path}: there are no pieces to write")
        examples = {key: getattr(first, key) for key in GROWING if getattr(first, key) is not None}
        values: dict[str, Any] = {key: _grown_array(grown[key], example) for key, example in examples.items()}
        values |= {"fps": first.fps, "caption": first.caption, "seed": first.seed, "skeleton": first.skeleton.name}
        values |= {"part_starts": starts or None, "part_captions": captions or None}
        values |= {"warning": first.warning or None, "unknown_words": first.unknown_words or None}
        with partial.open("wb") as file:
            np.savez_compressed(file, **{key: value for key, value in values.items() if value is not None})
    return frames


def _grown_array(file: IO[bytes], example: np.ndarray) -> np.ndarray:
    """Returns what was written to a file as an array of the type and the width of an example, without reading it."""
    file.flush()
    count = file.tell() // example[0].nbytes
    width = example.shape[1:] if example.shape[1:] != (1,) else ()  # as in `write_npz`
    return np.memmap(file, example.dtype, "r", shape=(count, *width))
