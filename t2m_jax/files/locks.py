"""Locks: one process at a time writes a destination."""

import contextlib
import os
import re
import socket
import zlib
from collections.abc import Iterator
from pathlib import Path

from t2m_jax.errors import UserError

MAX_NAME = 60
"""Longest name that is repeated in the names of locks and unfinished files. File systems limit names to 255 bytes."""
SECONDS = 0.2
"""Usual wait for a lock. The file may be deleted just after it was opened, so that one try is not enough."""
MAX_LOCK_FILE = 1024
"""Bytes of a lock file that are read: its owner is in the first 300, and a damaged file may have any size."""


def short_name(path: Path) -> str:
    """Returns the name of a destination, or a shorter one in its place."""
    name = path.name
    return name if len(name) <= MAX_NAME else f"{name[: MAX_NAME // 2]}-{zlib.crc32(name.encode(errors='replace')):08x}"


@contextlib.contextmanager
def lock(path: Path, *, seconds: float = SECONDS) -> Iterator[None]:
    """Holds the lock of a destination: a lock of the kernel (`flock`) on a file `.NAME.lock` beside it.

    In one process, the lock can be taken again by what is called inside. The kernel releases it when the process ends,
    however it ends, so a file that a killed process left blocks nobody, and the next owner deletes it.

    On network file systems, the lock excludes the processes of other hosts if the server has locks: on NFS unless it is
    mounted with `local_lock` or `nolock`, and on Lustre if it is mounted with `flock`. The server releases the lock of
    a host that is lost after its lease. With `local_lock` or `localflock`, only processes of one host exclude each
    other. If a file system has no `flock`, the library `filelock` says so and creates the file instead; such a lock of
    a killed process is taken over on the same host only.

    Args:
        path: The destination.
        seconds: How long to wait for another process.

    Raises:
        UserError: Another process holds it.
        OSError: The lock file cannot be written.
    """
    from filelock import FileLock, Timeout  # here, because reading needs no locks

    place = path.absolute().with_name(f".{short_name(path)}.lock")
    holder = FileLock(place, is_singleton=True, thread_local=False)
    try:
        holder.acquire(timeout=seconds)
    except Timeout:
        if not place.exists():  # `filelock` also waits in folders that take no file, such as `/proc`
            place.touch()  # says why; a file that is left blocks nobody
        owner = _owner(place) or "another process"
        raise UserError(f"{path}: is being written by {owner}; wait until it has finished, or end it") from None
    try:
        if holder.lock_counter == 1 and place.is_file():  # a pipe would block
            place.write_text(f"{os.getpid()}\n{socket.gethostname()}\n", encoding="utf-8")
        yield
    finally:
        # Deleted while it is locked: whoever opened it before finds that it has no name any more, and tries again.
        is_deleted = holder.lock_counter > 1 or _delete(place)
        holder.release()
        if not is_deleted:  # Windows refuses to delete what is open, here, and in the hands of another process
            _delete(place)


def _delete(place: Path) -> bool:
    """Deletes a lock file, and returns whether there is none any more."""
    with contextlib.suppress(OSError):
        if place.is_file():
            place.unlink()
        return True
    return False


def _owner(place: Path) -> str | None:
    """Returns process and host that a lock file names; None if it names none, or is not a file."""
    with contextlib.suppress(OSError):
        if place.is_file():  # to open a pipe would take forever
            with place.open("rb") as file:
                text = file.read(MAX_LOCK_FILE).decode(errors="replace")
            found = re.match(r"(\d+)\n(\S+)\n", text)
            return f"process {found[1]} on {found[2]}" if found else None
    return None
