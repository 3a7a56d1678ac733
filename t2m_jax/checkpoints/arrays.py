"""Trees of arrays in safetensors files: nothing is executed on reading."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import traverse_util
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from t2m_jax.errors import UserError


def save_arrays(path: Path, tree: Mapping[str, Any], *, half: bool = False) -> None:
    """Writes a nested dictionary of arrays; with `half` its floats are stored in 16 bits."""
    flat = traverse_util.flatten_dict(jax.device_get(dict(tree)), sep="/")
    arrays = {}
    for name, leaf in flat.items():
        array = np.asarray(leaf)
        arrays[name] = array.astype(np.float16) if half and array.dtype == np.float32 else array
    save_file(arrays, path)


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Returns the arrays of a file by name, as they are.

    Raises:
        UserError: if the file is missing or damaged.
    """
    try:
        return load_file(path)
    except FileNotFoundError:
        raise UserError(f"{path}: missing; the folder is not a complete model") from None
    except (SafetensorError, OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        raise UserError(f"{path}: damaged or not a safetensors file ({reason})") from None


def load_arrays(path: Path, expected: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the nested dictionary of a file, in the dtypes of `expected` (arrays or shape structs).

    Raises:
        UserError: if the file is missing or damaged, or its names, shapes or values are not as expected.
    """
    found = read_arrays(path)
    wanted = traverse_util.flatten_dict(dict(expected), sep="/")
    for name in sorted(wanted.keys() ^ found.keys()):
        kind = "is missing" if name in wanted else "is not part of the model its config describes"
        raise UserError(f"{path}: array {name!r} {kind}")
    for name, leaf in wanted.items():
        if found[name].shape != leaf.shape:
            raise UserError(f"{path}: array {name!r} has shape {found[name].shape}, its config wants {leaf.shape}")
        if not np.all(np.isfinite(found[name])):
            raise UserError(f"{path}: array {name!r} has values that are not finite")
    arrays = {name: found[name].astype(leaf.dtype) for name, leaf in wanted.items()}
    return traverse_util.unflatten_dict(arrays, sep="/")
