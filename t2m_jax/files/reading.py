"""Reads files without trusting them."""

import contextlib
import json
import math
import stat
import sys
from collections.abc import Iterator
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np

from t2m_jax.errors import UserError

BAD_ARRAY = (ValueError, TypeError, EOFError, SyntaxError, TokenError, MemoryError, OverflowError, BadZipFile, Warning)
"""What `np.load` raises for damaged files. It parses the header as Python source, trusts the sizes in it, and warns of
headers that old versions wrote. These warnings may have been made errors."""
MAX_UNPACKED = 2**28
"""The largest archive of arrays in bytes, unpacked: two hours of motion. A file of 300 kB can claim as much."""
MAX_TEXT = 2**26
"""The largest text or JSON file in bytes that is read whole. In memory, it may take ten times as much."""
MAX_DIGITS = 100
"""Of a whole number in JSON. NumPy and C take far less, and fail with an error of their own."""
GIVEN = ("/dev/", "/proc/")
"""Folders of pipes and devices that users give on purpose, as with `<(command)` in a shell."""


def first_line(error: BaseException) -> str:
    """Returns the first line of an error's text, or the name of its type if it has none."""
    return next(iter(str(error).splitlines()), type(error).__name__)


def check_input(path: Path, *, max_bytes: int = sys.maxsize) -> None:
    """Raises `UserError` for a pipe or device in a folder, which may never end, and for a file that is too large.

    What is missing or cannot be read is left to the reader, which says more.
    """
    if "\0" in str(path):  # a name that a file gave; Python's functions raise a `ValueError`
        raise UserError(f"{path}: no file can have this name, which has a NUL; correct it where it is written")
    try:
        found = path.stat()
    except OSError:
        return
    if not stat.S_ISREG(found.st_mode) and not stat.S_ISDIR(found.st_mode) and not str(path).startswith(GIVEN):
        raise UserError(f"{path}: is a pipe or device, not a file; is the copy complete?")
    if found.st_size > max_bytes:
        raise UserError(f"{path}: has {found.st_size:,} bytes; at most {max_bytes:,} are read")


@contextlib.contextmanager
def reading(path: Path, *, max_bytes: int = sys.maxsize) -> Iterator[None]:
    """Turns the errors of a missing or unreadable file, or of text that is not UTF-8, into a `UserError`.

    Pipes, devices and files that are too large are refused (see `check_input`).
    """
    check_input(path, max_bytes=max_bytes)
    try:
        yield
    except FileNotFoundError:
        raise UserError(f"{path}: there is no such file") from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error}); is the copy complete?") from None
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: is not UTF-8 text (byte {error.start}); save it as UTF-8") from None


def load_bytes(path: Path, *, max_bytes: int = sys.maxsize) -> bytes:
    """Returns the bytes of a file.

    Raises:
        UserError: The file is missing, cannot be read or is larger than `max_bytes`.
    """
    with reading(path, max_bytes=max_bytes):
        data = path.read_bytes()
    return data  # noqa: RET504 - for mypy, a `return` inside `with` may not be reached


def load_text(path: Path, *, max_bytes: int = MAX_TEXT) -> str:
    """Returns the text of a UTF-8 file, without the mark that some editors put at its beginning.

    Raises:
        UserError: The file is missing, cannot be read, is not UTF-8 or is larger than `max_bytes`.
    """
    with reading(path, max_bytes=max_bytes):
        text = path.read_text(encoding="utf-8-sig")
    return text  # noqa: RET504 - for mypy, a `return` inside `with` may not be reached


def _finite(number: str) -> float:
    if not math.isfinite(value := float(number)):
        raise ValueError(f"{number[:20]} is not a finite number")
    return value


def _whole(number: str) -> int:
    if len(number) > MAX_DIGITS:
        raise ValueError(f"{number[:20]}... has more than {MAX_DIGITS} digits")
    return int(number)


def parse_json(text: str) -> Any:
    """Returns the data of a JSON text.

    Raises:
        ValueError: It is not JSON, a number is not finite, or a whole number is larger than any that a file needs.
        RecursionError: It is nested too deep.
    """
    return json.loads(text, parse_float=_finite, parse_constant=_finite, parse_int=_whole)


def load_json(path: Path, *, max_bytes: int = MAX_TEXT) -> Any:
    """Returns the data of a JSON file.

    Raises:
        UserError: The file is missing, is not JSON or is larger than `max_bytes`, or a number in it is not finite.
    """
    text = load_text(path, max_bytes=max_bytes)
    try:
        return parse_json(text)
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: cannot be read as JSON ({first_line(error)})") from None


def load_array(path: Path, *, mmap: bool = False) -> np.ndarray:  # any shape: the caller checks it
    """Returns the array in a `.npy` file of floating-point numbers; with `mmap` the rows stay on disk until used.

    Raises:
        UserError: The file is missing or damaged, or holds something else.
    """
    with reading(path):
        try:
            array = np.load(path, mmap_mode="r" if mmap else None, allow_pickle=False)
        except BAD_ARRAY as error:
            raise UserError(f"{path}: is not a complete .npy file ({first_line(error)}); copy it again") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
        raise UserError(f"{path}: does not hold one array of floating-point numbers")
    return array


def _check_unpacked_size(path: Path, max_unpacked: int) -> None:
    with ZipFile(path) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if size > max_unpacked:
        raise UserError(f"{path}: unpacks to {size:,} bytes; at most {max_unpacked:,} are read")


def load_archive(path: Path, *, max_unpacked: int = MAX_UNPACKED) -> dict[str, np.ndarray]:
    """Returns the arrays of a `.npz` file by name, which have at most `max_unpacked` bytes.

    Raises:
        UserError: The file is missing or damaged, is too large when it is unpacked, or an entry holds Python objects.
    """
    key = ""
    arrays = {}
    with reading(path):
        try:
            _check_unpacked_size(path, max_unpacked)
            with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
                for key in archive.files:
                    arrays[key] = archive[key]
                    arrays[key].dtype  # noqa: B018 - something else than an array is given as its bytes
        except (UserError, OSError):
            raise
        except Exception as error:  # noqa: BLE001 - of zip, each compression in it, and NumPy, which trusts the file
            where = f"entry {key!r} is damaged or holds Python objects" if key else "this is not a complete .npz file"
            raise UserError(f"{path}: {where} ({first_line(error)})") from None
    return arrays
