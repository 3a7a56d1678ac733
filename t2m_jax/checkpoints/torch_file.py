"""Reads files of `torch.save` without PyTorch: nothing in them is run, and only what tensors need is understood.

There are two formats. PyTorch 1.6 and later write a zip archive with a pickle and one member per storage of numbers.
Earlier versions write several pickles, then the storages.
"""

import math
import os
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from t2m_jax.checkpoints.torch_pickle import MAX_PICKLE_BYTES, Name, Pickle, Storage, Tensor, read_pickle
from t2m_jax.errors import UserError
from t2m_jax.files.reading import check_input

MAX_DEPTH = 32
"""Deepest nesting of dictionaries and lists that is read; it bounds the recursion below."""
MAX_VALUES = 50_000
"""Largest number of values; a value in several places counts each time. A published model has 314."""
MAX_SHARING = 8
"""Largest number of tensor elements per byte of the file: tensors may share a storage, but only a few times."""
MAX_AXES = 16
"""Largest number of axes of a tensor; numpy allows 64."""

_ZIP_START = b"PK\x03\x04"
_LEGACY_START = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19."
"""The pickled number at the start of a file in the older format."""
_LEGACY_VERSION = 1001
_DAMAGED_ZIP = (zipfile.BadZipFile, RuntimeError, struct.error, ValueError, LookupError, EOFError, OverflowError)
"""What `zipfile` raises for damaged archives, and for encrypted ones."""

StorageReader = Callable[[Storage], np.ndarray]
"""Returns the numbers of a storage, after checking their count."""


def load_torch_file(path: str | Path) -> dict[str | int, Any]:
    """Returns the contents of a file of `torch.save`: nested dictionaries and lists of arrays, numbers and strings.

    Parameters become plain arrays, and devices are ignored. The arrays are read-only, because some may share memory.

    Raises:
        UserError: The file is not of `torch.save`, is damaged, or contains anything else; the message names it.
    """
    path = Path(path)
    check_input(path)
    try:
        with path.open("rb") as file:
            start = file.read(len(_LEGACY_START))
            if start.startswith(_ZIP_START):
                value = _read_archive(file)
            elif start == _LEGACY_START:
                value = _read_legacy(file)
            else:
                raise UserError("not a file of torch.save (.pth or .tar); download it again without unpacking it")
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from None
    except _DAMAGED_ZIP as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise UserError(f"{path}: cut off or damaged; download it again ({reason})") from None
    if not isinstance(value, dict):
        raise UserError(f"{path}: contains a {type(value).__name__}, but a dictionary of tensors is needed")
    return value


def _read_archive(file: BinaryIO) -> Any:
    """Returns the content of a file in the format of PyTorch 1.6 and later."""
    size = os.fstat(file.fileno()).st_size
    with zipfile.ZipFile(file) as archive:
        members = {member.filename: member for member in archive.infolist()}
        _check_members(archive, size)
        roots = [name for name in members if name.count("/") == 1 and name.endswith("/data.pkl")]
        if len(roots) != 1:
            raise UserError("a zip archive, but not of torch.save; use the downloaded file as it is")
        root = roots[0].removesuffix("/data.pkl")
        if members[f"{root}/data.pkl"].file_size > MAX_PICKLE_BYTES:
            raise UserError(
                f"its pickle is larger than {MAX_PICKLE_BYTES // 1_000_000} MB: not a model, or its weights are NumPy "
                "arrays; save them as tensors"
            )
        # Older versions of PyTorch do not write this member.
        order = archive.read(f"{root}/byteorder") if f"{root}/byteorder" in members else b"little"
        if order != b"little":
            raise UserError(f"its byte order is {order[:20]!r}; only little-endian files can be read")

        def read_storage(storage: Storage) -> np.ndarray:
            member = members.get(f"{root}/data/{storage.key}")
            if member is None or member.file_size != storage.length * storage.dtype.itemsize:
                raise UserError(f"storage {storage.key[:60]!r} is missing or has the wrong size")
            return _numbers(archive.read(member), storage.dtype)

        content = read_pickle(archive.read(f"{root}/data.pkl"))
        return _Content(read_storage, size).plain(content.value)


def _check_members(archive: zipfile.ZipFile, size: int) -> None:
    """Raises `UserError` if an archive could unpack to more than the size of the file."""
    members = archive.infolist()
    # By a name, `zipfile` reads the last of two members. What was checked must be what is read.
    if len({member.filename for member in members}) < len(members):
        raise UserError("its archive has two members of the same name")
    if any(member.compress_type != zipfile.ZIP_STORED for member in members):
        raise UserError("its archive is compressed, but torch.save does not compress; use the downloaded file as it is")
    if any(member.file_size != member.compress_size for member in members):
        raise UserError("its archive is damaged: a member has two sizes")
    # Members of a hostile archive may overlap: each fits into the file, but they unpack to many times its size.
    if sum(member.file_size for member in members) > size:
        raise UserError("its archive is damaged: the members are larger than the file")


def _read_legacy(file: BinaryIO) -> Any:
    """Returns the content of a file in the format before PyTorch 1.6."""
    file.seek(0)
    head = file.read(MAX_PICKLE_BYTES)
    version = read_pickle(head, start=len(_LEGACY_START))
    system = read_pickle(head, start=version.end)
    fits = isinstance(system.value, dict) and system.value.get("little_endian") is True
    if version.value != _LEGACY_VERSION or not fits:
        raise UserError("written by a version of PyTorch that cannot be read; load and save it with a current PyTorch")
    content = read_pickle(head, start=system.end)
    keys = read_pickle(head, start=content.end)
    places = _legacy_places(file, keys, content.storages)

    def read_storage(storage: Storage) -> np.ndarray:
        file.seek(places[storage.key])
        return _numbers(file.read(storage.length * storage.dtype.itemsize), storage.dtype)

    return _Content(read_storage, os.fstat(file.fileno()).st_size).plain(content.value)


def _legacy_places(file: BinaryIO, keys: Pickle, storages: dict[str, Storage]) -> dict[str, int]:
    """Returns the position of each storage. They follow the list of keys, each after its number of elements."""
    # `repr`, because keys of a hostile file need not be hashable.
    if not isinstance(keys.value, list) or {*map(repr, keys.value)} != {*map(repr, storages)}:
        raise UserError("its list of storages does not fit its tensors")
    position = keys.end
    places = {}
    for key in keys.value:
        file.seek(position)
        if file.read(8) != storages[key].length.to_bytes(8, "little"):
            raise UserError(f"storage {key[:60]!r} is missing or has the wrong size")
        places[key] = position + 8
        position += 8 + storages[key].length * storages[key].dtype.itemsize
    if position > os.fstat(file.fileno()).st_size:
        raise UserError("cut off; download it again")
    return places


def _numbers(content: bytes, dtype: np.dtype) -> np.ndarray:
    """Returns the numbers of a storage."""
    if dtype == np.bool_ and content.strip(b"\0\1"):
        raise UserError("has booleans that are neither true nor false")
    return np.frombuffer(content, dtype)


class _Content:
    """Turns the records of a pickle into arrays, and limits their number and size by the size of the file."""

    def __init__(self, read_storage: StorageReader, size: int):
        self._read_storage = read_storage
        self._rows: dict[str, np.ndarray] = {}
        self._values_left = MAX_VALUES
        self._numbers_left = MAX_SHARING * size

    def plain(self, value: Any, depth: int = 0) -> Any:
        """Returns a value with arrays in place of its tensors.

        Raises:
            UserError: Something in it is not a plain value, it is nested too deep, or it has too many values.
        """
        self._values_left -= 1
        if depth > MAX_DEPTH:
            raise UserError(f"nested deeper than {MAX_DEPTH} dictionaries and lists")
        if self._values_left < 0:
            raise UserError(f"has more than {MAX_VALUES} values")
        if isinstance(value, Tensor):
            return self._array(value)
        if isinstance(value, Name | Storage):
            raise UserError(f"contains a bare {type(value).__name__.lower()} in place of a tensor, number or string")
        if isinstance(value, dict):
            return {key: self.plain(item, depth + 1) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return type(value)(self.plain(item, depth + 1) for item in value)
        return value

    def _array(self, tensor: Tensor) -> np.ndarray:
        """Returns the array that a tensor describes, after checking that it is inside its storage."""
        storage, offset, shape, strides = tensor
        # `type` and not `isinstance` below: a `bool` is an `int`, too.
        axes_fit = isinstance(shape, tuple) and isinstance(strides, tuple) and len(shape) == len(strides) <= MAX_AXES
        if not axes_fit or any(type(number) is not int or number < 0 for number in (offset, *shape, *strides)):
            raise UserError("has a tensor whose shape, strides or offset are not valid")
        count = math.prod(shape)
        last = offset + sum((size - 1) * stride for size, stride in zip(shape, strides, strict=True))
        # An empty tensor has no last element, but numpy must be able to count its other axes.
        fits = (
            count <= storage.length and last < storage.length
            if count
            else math.prod(size or 1 for size in shape) < 2**31
        )
        if not fits:
            raise UserError("has a tensor whose shape and strides do not fit into its storage")
        self._numbers_left -= count
        if self._numbers_left < 0:
            raise UserError("has tensors that share their numbers more often than those of any model")
        if not count:
            return np.zeros(shape, storage.dtype)
        # Each storage is read once. Tensors that share it are views.
        if storage.key not in self._rows:
            self._rows[storage.key] = self._read_storage(storage)
        row = self._rows[storage.key]
        byte_strides = [stride * row.itemsize for stride in strides]
        return np.lib.stride_tricks.as_strided(row[offset:], shape, byte_strides, writeable=False)
