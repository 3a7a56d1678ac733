"""Files: written whole or not at all, and read without trusting them.

Writers of data and models use `atomic_file` or `atomic_folder`. A reader that meets the destination sees the old
contents or the new ones, never a part of them.
"""

import contextlib
import json
import math
import os
import secrets
import shutil
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from t2m_jax.errors import UserError

DAMAGED_ARRAY = (
    ValueError,
    TypeError,
    EOFError,
    SyntaxError,
    TokenError,
    MemoryError,
    OverflowError,
    zipfile.BadZipFile,
)
"""What `np.load` raises for damaged files. It parses the header as Python source and trusts the sizes in it."""
DAMAGED_WEIGHTS = (SafetensorError, OSError, ValueError, LookupError, TypeError, AttributeError)
"""What safetensors raises for damaged files."""


def first_line(error: BaseException) -> str:
    """Returns the first line of an error's text, or the name of its type if it has none."""
    return next(iter(str(error).splitlines()), type(error).__name__)


def check_output(path: str | os.PathLike[str]) -> Path:
    """Returns the path of a file to write.

    Call this before long work, so that a wrong path is reported first.

    Raises:
        UserError: The path is a folder, or its folder does not exist or is not writable.
    """
    path = Path(path)
    folder = path.absolute().parent
    try:
        if path.is_dir():
            raise UserError(f"{path}: cannot be written, it is a folder; give the name of a file")
        if not folder.is_dir():
            raise UserError(f"{path}: the folder {folder} does not exist; create it or choose another")
        if not os.access(path if path.exists() else folder, os.W_OK):
            raise UserError(f"{path}: cannot be written (no permission); choose another place")
    except OSError as error:  # such as a name that is too long
        raise UserError(f"{path}: cannot be written ({error.strerror}); choose another place") from error
    return path


def check_new(path: Path) -> None:
    """Raises `UserError` if a folder to write exists already. An empty folder may be replaced."""
    if path.exists() and not (path.is_dir() and next(path.iterdir(), None) is None):
        raise UserError(f"{path}: exists already; choose another folder or remove it")


@contextlib.contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a temporary path in the same folder, which replaces `path` when the block ends.

    If the block fails, the temporary file is deleted and an older file at `path` is kept.

    Raises:
        UserError: `path` cannot be written, or the disk is full.
    """
    path = check_output(path)
    # The suffix is kept because encoders choose the container by it. The name is short because file systems limit it.
    partial = path.with_name(f".{secrets.token_hex(16)}{path.suffix}")
    try:
        yield partial
        partial.replace(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        partial.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Yields a temporary folder beside `path`, which is renamed to `path` when the block ends.

    If the block fails, the temporary folder is deleted.

    Raises:
        UserError: `path` exists already, or cannot be written.
    """
    check_new(path)
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        partial.mkdir(parents=True)
        yield partial
        partial.replace(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turns the errors of a missing or unreadable file, or of text that is not UTF-8, into a `UserError`."""
    try:
        yield
    except FileNotFoundError:
        raise UserError(f"{path}: there is no such file") from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error}); is the copy complete?") from None
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: is not UTF-8 text (byte {error.start}); save it as UTF-8") from None


def save_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes text as UTF-8; each line ends with a line feed on every system."""
    with atomic_file(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="\n")


def save_json(path: str | os.PathLike[str], data: Any) -> None:
    """Writes plain data as JSON with sorted keys.

    Raises:
        ValueError: A number is not finite.
    """
    save_text(path, json.dumps(data, indent=2, sort_keys=True, allow_nan=False) + "\n")


def load_text(path: Path) -> str:
    """Returns the text of a UTF-8 file.

    Raises:
        UserError: The file is missing, cannot be read or is not UTF-8.
    """
    with reading(path):
        text = path.read_text(encoding="utf-8")
    return text  # noqa: RET504 - for mypy, a `return` inside `with` may not be reached


def _finite(number: str) -> float:
    if not math.isfinite(value := float(number)):
        raise ValueError(f"{number[:20]} is not a finite number")
    return value


def load_json(path: Path) -> Any:
    """Returns the data of a JSON file.

    Raises:
        UserError: The file is missing or is not JSON, or a number in it is not finite.
    """
    text = load_text(path)
    try:
        return json.loads(text, parse_float=_finite, parse_constant=_finite)
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
        except DAMAGED_ARRAY as error:
            raise UserError(f"{path}: is not a complete .npy file ({first_line(error)}); copy it again") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
        raise UserError(f"{path}: does not hold one array of floating-point numbers")
    return array


def load_archive(path: Path) -> dict[str, np.ndarray]:
    """Returns the arrays of a `.npz` file by name.

    Raises:
        UserError: The file is missing or damaged, or an entry holds Python objects.
    """
    key, arrays = "", {}
    with reading(path):
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
                for key in archive.files:
                    arrays[key] = archive[key]
        except (*DAMAGED_ARRAY, zlib.error, AttributeError, NotImplementedError) as error:
            where = f"entry {key!r} is damaged or holds Python objects" if key else "this is not a complete .npz file"
            raise UserError(f"{path}: {where} ({first_line(error)})") from None
    return arrays


def flatten_tree(tree: Mapping[str, Any], *, prefix: str = "") -> dict[str, Any]:
    """Returns the leaves of nested dictionaries by their path, such as `params/decoder/kernel`."""
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        path = f"{prefix}{name}"
        flat |= flatten_tree(value, prefix=f"{path}/") if isinstance(value, Mapping) else {path: value}
    return flat


def unflatten_tree(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the nested dictionaries of which `flatten_tree` made `flat`."""
    tree: dict[str, Any] = {}
    for path, value in flat.items():
        *parents, name = path.split("/")
        place = tree
        for parent in parents:
            place = place.setdefault(parent, {})
        place[name] = value
    return tree


def save_weights(path: Path, arrays: Mapping[str, np.ndarray], *, metadata: dict[str, str] | None = None) -> None:
    """Writes arrays by name as a safetensors file that everybody may read."""
    with atomic_file(path) as partial:
        save_file(dict(arrays), partial, metadata=metadata)
        partial.chmod(0o644)  # safetensors makes its files private, but models are made to be shared


def save_arrays(path: Path, tree: Mapping[str, Any], *, half: bool = False) -> None:
    """Writes nested dictionaries of arrays as a safetensors file; with `half`, float32 is stored in 16 bits."""
    arrays = {name: np.asarray(leaf) for name, leaf in flatten_tree(tree).items()}
    if half:
        arrays = {name: a.astype(np.float16) if a.dtype == np.float32 else a for name, a in arrays.items()}
    save_weights(path, arrays)


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Returns the arrays of a safetensors file by name, as they are.

    Raises:
        UserError: The file is missing or damaged.
    """
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
    leaves = {name: (leaf.shape, leaf.dtype) for name, leaf in flatten_tree(expected).items()}
    return unflatten_tree(fit_arrays(path, read_arrays(path), leaves))
