"""Writes files and folders whole or not at all.

A reader that meets the destination sees the old contents or the new ones, never a part of them. This also holds if the
machine fails: contents are on the disk before they get their name.
"""

import concurrent.futures
import contextlib
import errno
import json
import logging
import os
import secrets
import shutil
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from t2m_jax.errors import UserError
from t2m_jax.files.locks import SECONDS, lock, short_name

logger = logging.getLogger(__name__)

ABANDONED_SECONDS = 3600.0
"""Age after which the unfinished contents of a file or folder are deleted: the process that wrote them was killed."""
PARTIAL = ".partial"
"""Part of the names of files and folders that are not finished."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Numbers of the errors for a full disk, a used up quota and the limit on the size of a file."""
SHORT_WRITE = "requested and"
"""What NumPy writes in its error in place of a number if there was no room for an array."""
SYNC_THREADS = 16
"""Files of a folder that are brought to the disk at once. Each waits for the disk."""


def check_output(path: str | os.PathLike[str]) -> Path:
    """Returns the path of a file to write.

    Call this before long work, so that a wrong path is reported first.

    Raises:
        UserError: The path is a folder or a device, or its folder does not exist or is not writable.
    """
    path = Path(path)
    folder = path.absolute().parent
    try:
        if path.is_dir():
            raise UserError(f"{path}: cannot be written, it is a folder; give the name of a file")
        if path.exists() and not path.is_file():
            raise UserError(f"{path}: cannot be written, it is a pipe or device; give the name of a file")
        if not folder.is_dir():
            raise UserError(f"{path}: the folder {folder} does not exist; create it or choose another")
        if not os.access(path if path.exists() else folder, os.W_OK):
            raise UserError(f"{path}: cannot be written (no permission); choose another place")
    except OSError as error:  # such as a name that is too long
        raise UserError(f"{path}: cannot be written ({error.strerror}); choose another place") from error
    return path


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turns the errors of a full disk, and of a path that cannot be written, into a `UserError`.

    In an unfinished folder, they are left to the writer of the folder, who knows its name.
    """
    try:
        yield
    except OSError as error:
        if _is_unfinished(path):
            raise
        reason = error.strerror or str(error)
        if has_no_room := SHORT_WRITE in reason:
            reason = os.strerror(errno.ENOSPC)
        is_full = has_no_room or error.errno in FULL
        advice = "make room, then try again" if is_full else "choose another place"
        raise UserError(f"{path}: cannot be written ({reason}); {advice}") from error


@contextlib.contextmanager
def claim(outputs: Iterable[Path], *, tells: bool = True) -> Iterator[None]:
    """Holds the locks of files that a command is going to write, and says which of them will be replaced.

    Deletes what killed processes left of their attempts.

    Args:
        outputs: The files.
        tells: False leaves it to the caller to say that (`tell_replaced`), if requests may yet be refused.

    Raises:
        UserError: Another process is writing one of them, or its folder cannot be written.
    """
    with contextlib.ExitStack() as held:
        for path in outputs:
            with writing(path):
                held.enter_context(lock(path))
            _delete_abandoned(path)
            if tells:
                tell_replaced(path)
        yield


def tell_replaced(path: Path) -> None:
    """Says that a file will be replaced, if it exists."""
    if path.exists():
        logger.info("%s: exists and will be replaced", path)


def check_new(path: Path) -> None:
    """Raises `UserError` if a folder to write exists already. An empty folder may be replaced."""
    if not path.name:
        raise UserError(f"{path}: is the folder that you are in, or a whole disk; give the name of a new folder")
    if path.exists() and not (path.is_dir() and next(path.iterdir(), None) is None):
        raise UserError(f"{path}: exists already; choose another folder or remove it")


@contextlib.contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a temporary path in the same folder, which replaces `path` when the block ends.

    If the block fails, the temporary file is deleted and an older file at `path` is kept. A link stays a link: the file
    it points to is replaced. The mode of an older file is kept.

    Raises:
        UserError: `path` cannot be written, or the disk is full.
    """
    path = check_output(path)
    target = path.resolve() if path.is_symlink() else path
    # The suffix is kept because encoders choose the container by it.
    partial = _partial(target, path.suffix)
    try:
        with writing(path):
            yield partial
            if target.exists():
                partial.chmod(target.stat().st_mode & 0o777)
            # What is in an unfinished folder is brought to the disk with it, thousands of files at once.
            if not _is_unfinished(target):
                _sync(partial)
            partial.replace(target)
            if not _is_unfinished(target):
                _sync(target.absolute().parent)
    finally:
        partial.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_folder(path: Path, *, seconds: float = SECONDS) -> Iterator[Path]:
    """Yields a temporary folder next to `path`, which is renamed to `path` when the block ends.

    If the block fails, the temporary folder is deleted. Two processes cannot make the same folder at once: the second
    waits for some `seconds`.

    Raises:
        UserError: `path` exists already, cannot be written, or another process is making it.
    """
    check_new(path)
    with writing(path):
        path.absolute().parent.mkdir(parents=True, exist_ok=True)
        with lock(path, seconds=seconds):
            check_new(path)
            _delete_abandoned(path)
            partial = _partial(path, "")
            try:
                partial.mkdir()
                yield partial
                commit_folder(partial, path)
            finally:
                shutil.rmtree(partial, ignore_errors=True)


def commit_folder(partial: Path, path: Path) -> None:
    """Gives a finished folder its name, after all its files are on the disk."""
    with concurrent.futures.ThreadPoolExecutor(SYNC_THREADS) as threads:
        for _ in threads.map(_sync, (partial, *partial.rglob("*"))):
            pass
    if path.is_dir():
        path.rmdir()  # it is empty; Windows does not replace folders
    partial.replace(path)
    _sync(path.absolute().parent)


def _partial(path: Path, suffix: str) -> Path:
    return path.with_name(f"{_partial_start(path)}{secrets.token_hex(8)}{PARTIAL}{suffix}")


def _is_unfinished(path: Path) -> bool:
    """Returns whether a path is in an unfinished folder."""
    return any(part.endswith(PARTIAL) for part in path.parts[:-1])


def _partial_start(path: Path) -> str:
    return f".{short_name(path)}."


def _delete_abandoned(path: Path) -> None:
    """Deletes what killed processes left of their attempts to write a file or folder."""
    start = _partial_start(path)
    with os.scandir(path.absolute().parent) as entries:
        for entry in entries:
            if not entry.name.startswith(start) or PARTIAL not in entry.name:
                continue
            with contextlib.suppress(OSError):  # another process may delete it, too
                is_folder = entry.is_dir(follow_symlinks=False)
                found = Path(entry.path)
                newest = max(part.stat().st_mtime for part in (found, *(found.iterdir() if is_folder else ())))
                if time.time() - newest > ABANDONED_SECONDS:
                    shutil.rmtree(found) if is_folder else found.unlink()


def _sync(path: Path) -> None:
    """Waits until a file or folder is on the disk."""
    is_folder = path.is_dir()
    # Windows, and some file systems of networks, cannot do this for folders.
    with contextlib.suppress(OSError) if is_folder else contextlib.nullcontext():
        descriptor = os.open(path, os.O_RDONLY if is_folder or os.name != "nt" else os.O_RDWR)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def save_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes text as UTF-8; each line ends with a line feed on every system.

    Raises:
        UserError: The text has half of a character (a lone surrogate), or the file cannot be written.
    """
    try:
        data = text.encode()
    except UnicodeEncodeError as error:
        wrong = ascii(text[error.start : error.end])
        raise UserError(f"{path}: cannot be written, {wrong} is half a character; remove it from the text") from None
    with atomic_file(path) as partial:
        partial.write_bytes(data)


def save_json(path: str | os.PathLike[str], data: Any) -> None:
    """Writes plain data as JSON with sorted keys.

    Raises:
        ValueError: A number is not finite.
    """
    save_text(path, json.dumps(data, indent=2, sort_keys=True, allow_nan=False) + "\n")
