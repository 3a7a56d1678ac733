"""Locks: one process at a time writes a destination."""

import contextlib
import logging
from collections.abc import Iterable, Iterator
from pathlib import Path

from t2m_jax.errors import UserError

logger = logging.getLogger(__name__)


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


@contextlib.contextmanager
def claim(outputs: Iterable[Path]) -> Iterator[None]:
    """Holds the locks of files that a command is going to write, and says which of them will be replaced.

    Raises:
        UserError: Another process is writing one of them, or its folder cannot be written.
    """
    with contextlib.ExitStack() as held:
        for path in outputs:
            try:
                held.enter_context(lock(path))
            except OSError as error:
                raise UserError(
                    f"{path}: cannot be written ({error.strerror or error}); choose another place"
                ) from error
            if path.exists():
                logger.info("%s: exists and will be replaced", path)
        yield
