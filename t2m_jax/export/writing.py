"""Files that appear whole or not at all."""

import contextlib
import os
import pathlib
import uuid
from collections.abc import Iterator, Sequence

from t2m_jax.errors import UserError
from t2m_jax.motion.record import Motion


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[pathlib.Path]:
    """Yields a path beside `path` to write to; what is there afterwards takes the place of `path`.

    If the block fails, whatever it wrote is deleted and an older file at `path` stays as it was.

    Raises:
        UserError: The folder does not exist or cannot be written to, the disk is full.
    """
    path = pathlib.Path(path)
    if path.is_dir():
        raise UserError(f"{path}: this is a folder; give the name of a file")
    if not path.parent.is_dir():
        raise UserError(f"{path}: the folder {path.parent} does not exist; create it or choose another")
    # Same suffix, because encoders choose the container by it; short, because names have a greatest length.
    part = path.with_name(f".{uuid.uuid4().hex}{path.suffix}")
    try:
        yield part
        part.replace(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        part.unlink(missing_ok=True)


def only_motion(path: pathlib.Path, motions: Sequence[Motion]) -> Motion:
    """Returns the one motion of `motions`, for formats that hold no more.

    Raises:
        UserError: There are several, or none.
    """
    if len(motions) != 1:
        raise UserError(
            f"{path}: a {path.suffix} file holds exactly one motion, not {len(motions)}; write one file each"
        )
    return motions[0]
