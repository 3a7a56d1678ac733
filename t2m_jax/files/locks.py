"""Locks: one process at a time writes a destination."""

import contextlib
import os
import re
import stat
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from t2m_jax.errors import UserError

if TYPE_CHECKING:
    from filelock import SoftFileLock

MAX_NAME = 60
"""Longest name that is repeated in the names of locks and unfinished files. File systems limit names to 255 bytes."""
OWNERLESS_SECONDS = 10.0
"""Age after which a lock file that names no owner is taken over. Its process was killed between creating the file and
writing its own name, which takes milliseconds; the rest is for network file systems whose clocks differ."""
MAX_LOCK_FILE = 1024
"""Bytes of a lock file that are read: its owner is in the first 300, and a damaged file may have any size."""


class LockedError(UserError):
    """Another process writes the destination."""


def short_name(path: Path) -> str:
    """Returns the name of a destination, or a shorter one that stands for it."""
    name = path.name
    return name if len(name) <= MAX_NAME else f"{name[: MAX_NAME // 2]}-{zlib.crc32(name.encode(errors='replace')):08x}"


@contextlib.contextmanager
def lock(path: Path) -> Iterator[None]:
    """Holds the lock of a destination, which is a file `.NAME.lock` beside it with process and host of the owner.

    In one process, the lock can be taken again by what is called inside. The lock of a process that was killed is taken
    over, unless it ran on another host, where this host cannot see whether it still runs. The command line lets no
    signal interrupt the code of this module, so that no lock file is left that nobody knows.

    Raises:
        LockedError: Another process holds it.
        OSError: The file cannot be written.
    """
    from filelock import SoftFileLock  # here, because reading needs no locks

    place = path.absolute().with_name(f".{short_name(path)}.lock")
    holder = SoftFileLock(place, timeout=0, is_singleton=True, thread_local=False)
    _acquire(holder, path, place)
    try:
        yield
    finally:
        holder.release()


def _acquire(holder: "SoftFileLock", path: Path, place: Path) -> None:
    """Takes the lock of a destination, or raises `LockedError`."""
    from filelock import Timeout

    try:
        try:
            holder.acquire()
        except Timeout:
            _delete_ownerless(place)
            holder.acquire()
    except Timeout:
        owner = "another process"
        with contextlib.suppress(OSError):
            owner = _owner(place) or owner
        advice = f"wait for it, or delete {place} if that process is gone"
        raise LockedError(f"{path}: is being written by {owner}; {advice}") from None


def _owner(place: Path) -> str | None:
    """Returns process and host that a lock file names; None if it names none, or is not a file."""
    if not place.is_file():  # to open a pipe would take forever
        return None
    with place.open("rb") as file:
        text = file.read(MAX_LOCK_FILE).decode(errors="replace")
    # A record without its last line end was cut off when it was written.
    found = re.match(r"\s*(\d+)\s+(\S+)", text) if text.endswith("\n") else None
    return f"process {found[1]} on {found[2]}" if found else None


def _delete_ownerless(place: Path) -> None:
    """Deletes a lock file that names no owner and is older than `OWNERLESS_SECONDS`; `filelock` would keep it forever.

    Of several processes that want to delete the same file, only one does: the one that gives it a second name, which
    follows from the file and its time. A lock that was taken in the meantime is another file and is kept. The file is
    also kept if the file system has no links.
    """
    with contextlib.suppress(OSError):
        found = place.lstat()
        if not _is_ownerless(place, found):
            return
        second = place.with_name(f"{place.name}.{found.st_ino}-{found.st_mtime_ns}")
        os.link(place, second)
        try:
            now = second.lstat()
            if (now.st_ino, now.st_mtime_ns) == (found.st_ino, found.st_mtime_ns) and _is_ownerless(second, now):
                place.unlink()
        finally:
            second.unlink()


def _is_ownerless(place: Path, found: os.stat_result) -> bool:
    """Returns whether a lock file is old enough, and does not name its owner."""
    is_old = time.time() - found.st_mtime > OWNERLESS_SECONDS
    return is_old and stat.S_ISREG(found.st_mode) and _owner(place) is None
