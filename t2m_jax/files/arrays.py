"""Nested dictionaries of arrays as safetensors files."""

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from flax import traverse_util
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from t2m_jax.errors import UserError
from t2m_jax.files.reading import check_input, first_line
from t2m_jax.files.writing import atomic_file

DAMAGED_WEIGHTS = (SafetensorError, OSError, ValueError, LookupError, TypeError, AttributeError)
"""What safetensors raises for damaged files."""


def write_header(file: BinaryIO, shape: tuple[int, ...], dtype: type[np.generic]) -> None:
    """Writes the header of a `.npy` file at its beginning, before and again after rows whose number is not known.

    NumPy pads headers, so that both have the same length.
    """
    header = {"descr": np.lib.format.dtype_to_descr(np.dtype(dtype)), "fortran_order": False, "shape": shape}
    file.seek(0)
    np.lib.format.write_array_header_1_0(file, header)


def fingerprint(text: str, arrays: Mapping[str, Any], *others: Mapping[str, Any]) -> str:
    """Returns what identifies a text and some arrays: 16 hexadecimal digits of a digest."""
    digest = hashlib.sha256(text.encode())
    for flat in (
        sorted(traverse_util.flatten_dict(dict(arrays), sep="/").items()),
        *(other.items() for other in others),
    ):
        for name, array in flat:
            digest.update(name.encode() + np.ascontiguousarray(array, np.float32).tobytes())
    return digest.hexdigest()[:16]


def save_weights(path: Path, arrays: Mapping[str, np.ndarray], *, metadata: dict[str, str] | None = None) -> None:
    """Writes arrays by name as a safetensors file that everybody may read."""
    with atomic_file(path) as partial:
        try:
            save_file(dict(arrays), partial, metadata=metadata)
        except SafetensorError as error:  # it has the system's number of the error in its text
            number = re.search(r"os error (\d+)", str(error))
            raise OSError(int(number[1]) if number else None, str(error).partition(" (os")[0]) from error
        partial.chmod(0o644)  # safetensors makes its files private, but models are made to be shared


def save_arrays(path: Path, tree: Mapping[str, Any], *, half: bool = False) -> None:
    """Writes nested dictionaries of arrays as a safetensors file; with `half`, float32 is stored in 16 bits."""
    flat = traverse_util.flatten_dict(dict(tree), sep="/")
    arrays = {name: np.asarray(leaf) for name, leaf in flat.items()}
    if half:
        arrays = {name: a.astype(np.float16) if a.dtype == np.float32 else a for name, a in arrays.items()}
    save_weights(path, arrays)


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Returns the arrays of a safetensors file by name, as they are.

    Raises:
        UserError: The file is missing or damaged.
    """
    check_input(path)
    try:
        return load_file(path)
    except FileNotFoundError:
        raise UserError(f"{path}: missing; the folder is not a complete model") from None
    except DAMAGED_WEIGHTS as error:
        raise UserError(f"{path}: damaged or not a safetensors file ({first_line(error)})") from None


def fit_arrays(
    path: Path, found: Mapping[str, np.ndarray], expected: Mapping[str, tuple[tuple[int, ...], Any]]
) -> dict[str, np.ndarray]:
    """Returns the arrays of a file in the dtypes of a model.

    Args:
        path: The file, for error messages.
        found: Its arrays by name.
        expected: Shape and dtype of each array by name.

    Raises:
        UserError: Names, shapes or values are not as expected.
    """
    for name in sorted(expected.keys() ^ found.keys()):
        problem = "is missing" if name in expected else "is not part of the model that its config describes"
        raise UserError(f"{path}: array {name[:80]!r} {problem}")
    arrays = {}
    for name, (shape, dtype) in expected.items():
        array = found[name]
        if array.shape != shape:
            raise UserError(f"{path}: array {name!r} has shape {array.shape}; its config needs {shape}")
        if np.dtype(dtype).kind == "f" and array.dtype.kind != "f" and array.dtype.name != "bfloat16":
            raise UserError(f"{path}: array {name!r} holds {array.dtype}, not floating-point numbers")
        with np.errstate(all="ignore"):  # numbers that are too large become infinite, and are refused
            arrays[name] = array.astype(dtype, copy=False)
        if not np.all(np.isfinite(arrays[name])):
            raise UserError(f"{path}: array {name!r} has values that are not finite")
    return arrays


def load_arrays(path: Path, expected: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the nested dictionaries of a safetensors file.

    Args:
        path: The file.
        expected: The structure, with a shape and a dtype in each leaf. The arrays are returned in these dtypes.

    Raises:
        UserError: The file is missing or damaged, or its names, shapes or values are not as expected.
    """
    flat = traverse_util.flatten_dict(dict(expected), sep="/")
    leaves = {name: (leaf.shape, leaf.dtype) for name, leaf in flat.items()}
    return traverse_util.unflatten_dict(fit_arrays(path, read_arrays(path), leaves), sep="/")
