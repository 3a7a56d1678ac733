"""Locks: one process at a time writes a destination."""

import contextlib
import zlib
from collections.abc import Iterator
from pathlib import Path

from t2m_jax.errors import UserError

MAX_NAME = 60
"""Longest name that is repeated in the names of locks and unfinished files. File systems limit names to 255 bytes."""


def short_name(path: Path) -> str:
    """Returns the name of a destination, or a shorter one that stands for it."""
    name = path.name
    return name if len(name) <= MAX_NAME else f"{name[: MAX_NAME // 2]}-{zlib.crc32(name.encode(errors='replace')):08x}"


@contextlib.contextmanager
def lock(path: Path) -> Iterator[None]:
    """Holds the lock of a destination, which is a file `.NAME.lock` beside it with process and host of the owner.

    In one process, the lock can be taken again by what is called inside. The lock of a process that was killed is taken
    over.

    Raises:
        UserError: Another process holds it.
        OSError: The file cannot be written.
    """
    from filelock import SoftFileLock, Timeout  # here, because reading needs no locks

    place = path.absolute().with_name(f".{short_name(path)}.lock")
    holder = SoftFileLock(place, timeout=0, is_singleton=True, thread_local=False)
    try:
        holder.acquire()
    except Timeout:
        owner = f"process {holder.pid}" if holder.pid is not None else "another process"
        raise UserError(f"{path}: is being written by {owner}; wait for it, or choose another place") from None
    try:
        yield
    finally:
        holder.release()
