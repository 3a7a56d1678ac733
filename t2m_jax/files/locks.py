"""Locks: one process at a time writes a destination."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from filelock import SoftFileLock, Timeout

from t2m_jax.errors import UserError


@contextlib.contextmanager
def lock(path: Path) -> Iterator[None]:
    """Holds the lock of a destination, which is a file `.NAME.lock` beside it with process and host of the owner.

    In one process, the lock can be taken again by what is called inside. The lock of a process that was killed is taken
    over.

    Raises:
        UserError: Another process holds it.
        OSError: The file cannot be written.
    """
    place = path.absolute().with_name(f".{path.name[:60]}.lock")
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
