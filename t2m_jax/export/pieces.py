"""Writing a motion of any length while it is generated: frames go to the disk, and only one piece is in memory."""

import contextlib
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any

import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.files import atomic_file
from t2m_jax.motion.motion import Motion

STREAMED = ("positions", "features", "codes")
"""Entries of the archive that grow with the motion."""


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
        grown = {key: stack.enter_context(tempfile.TemporaryFile(dir=path.absolute().parent)) for key in STREAMED}
        first: Motion | None = None
        starts: list[int] = []
        captions: list[str] = []
        frames = 0
        for piece in pieces:
            first = first or piece
            starts += [frames + start for start in piece.part_starts]
            captions += piece.part_captions
            frames += piece.num_frames
            for key in STREAMED:
                if getattr(piece, key) is not None:
                    grown[key].write(np.ascontiguousarray(getattr(piece, key)).data)
        if first is None:
            raise UserError(f"{path}: there are no pieces to write")
        examples = {key: getattr(first, key) for key in STREAMED if getattr(first, key) is not None}
        values: dict[str, Any] = {key: _grown_array(grown[key], example) for key, example in examples.items()}
        values |= {"fps": first.fps, "caption": first.caption, "seed": first.seed, "skeleton": first.skeleton.name}
        values |= {"part_starts": starts or None, "part_captions": captions or None}
        with partial.open("wb") as file:
            np.savez_compressed(file, **{key: value for key, value in values.items() if value is not None})
    return frames


def _grown_array(file: IO[bytes], example: np.ndarray) -> np.ndarray:
    """Returns what was written to a file as an array of the type and the width of an example, without reading it."""
    file.flush()
    count = file.tell() // example[0].nbytes
    width = example.shape[1:] if example.shape[1:] != (1,) else ()  # as in `write_npz`
    return np.memmap(file, example.dtype, "r", shape=(count, *width))
