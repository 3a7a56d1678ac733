"""The files of a CLIP in the Hugging Face layout: where they are, and the arrays of the text tower in them."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import platformdirs
from flax import serialization, traverse_util
from safetensors import SafetensorError, safe_open

from t2m_jax.checkpoints.torch_file import load_torch_file
from t2m_jax.errors import UserError

CONFIG_FILE = "config.json"
TOKENIZER_FILES = ("tokenizer.json", "vocab.json", "merges.txt")
TEXT_PREFIX = "text_model."
_TEXT_PARTS = ("embeddings.", "encoder.", "final_layer_norm.", "text_projection.")
_HUB_NAME = re.compile(r"[A-Za-z0-9][\w.-]*/[\w.-]+")

StateDict = dict[str, np.ndarray]

_UNREADABLE = (
    OSError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,
    RecursionError,
    MemoryError,
)
"""What Flax raises on hostile files: it uses their contents without looking whether they are what it expects."""


def find_clip(name_or_folder: str | Path) -> Path:
    """Returns the folder of a CLIP: the path itself, else what the user or the hub's client has put on this machine.

    Only a hub name that is nowhere on this machine is downloaded.

    Raises:
        UserError: if there is no such folder, or the hub name is neither here nor can be downloaded.
    """
    if Path(name_or_folder).is_dir():
        return Path(name_or_folder)
    name = str(name_or_folder)
    if isinstance(name_or_folder, Path) or not _HUB_NAME.fullmatch(name):
        raise UserError(f"{name}: no such folder; give the folder of a CLIP or a hub name such as openai/clip-…")
    folder = user_folder(name)
    return folder if folder.is_dir() else _hub_snapshot(name)


def user_folder(name: str) -> Path:
    """Returns where a user may put the files of a hub name by hand."""
    return Path(platformdirs.user_data_dir("t2m_jax")) / "clip" / name.replace("/", "--")


def _hub_snapshot(name: str) -> Path:
    """Returns the folder the hub's client keeps a CLIP in, downloaded (in one weight format) if need be."""
    import huggingface_hub  # here, because only a hub name needs it

    reason = ""
    for offline in (True, False):
        for weights in WEIGHT_FILES:
            try:
                snapshot = huggingface_hub.snapshot_download(
                    name, allow_patterns=[CONFIG_FILE, *TOKENIZER_FILES, weights], local_files_only=offline
                )
            except Exception as error:  # noqa: BLE001 - the client passes on whatever its HTTP library raises
                reason = next(iter(str(error).splitlines()), type(error).__name__)
                if offline:
                    continue
                break
            if _is_complete(Path(snapshot), weights):
                return Path(snapshot)
            reason = f"it has no {weights} or no tokenizer"
    raise UserError(
        f"{name}: no such folder, and not found on the Hugging Face hub ({reason}); download {CONFIG_FILE}, "
        f"tokenizer.json (or vocab.json and merges.txt) and {' or '.join(WEIGHT_FILES)} "
        f"from https://huggingface.co/{name}/tree/main into {user_folder(name)}"
    )


def _is_complete(folder: Path, weights: str) -> bool:
    """Returns whether a snapshot, which may be partial, has what a CLIP needs."""
    tokenizer, *older = TOKENIZER_FILES
    has_tokenizer = (folder / tokenizer).is_file() or all((folder / name).is_file() for name in older)
    return has_tokenizer and (folder / CONFIG_FILE).is_file() and (folder / weights).is_file()


def read_clip_config(folder: Path) -> dict[str, Any]:
    """Returns the text part of `config.json`, with `projection_dim` as the whole model has it.

    Raises:
        UserError: if the file is missing or describes no CLIP.
    """
    path = folder / CONFIG_FILE
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UserError(f"{path}: missing; the folder is not a complete CLIP") from None
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(f"{path}: not a JSON file ({error})") from None
    kind = data.get("model_type") if isinstance(data, dict) else None
    if kind == "clip_text_model":
        return data
    if kind != "clip":
        raise UserError(f"{path}: model_type is {kind!r}, not 'clip' or 'clip_text_model'")
    text: dict[str, Any] = {}
    for section in ("text_config", "text_config_dict"):  # early files have both, and the second counts
        found = data.get(section)
        if not isinstance(found, dict | None):
            raise UserError(f"{path}: {section} is not a section of fields")
        text |= found or {}
    if "projection_dim" in data:
        text["projection_dim"] = data["projection_dim"]
    return text


def read_text_arrays(folder: Path) -> tuple[Path, StateDict]:
    """Returns the weight file of a CLIP's folder, and the arrays of its text tower by PyTorch's names, unprefixed.

    Raises:
        UserError: if there is no weight file, or it is damaged.
    """
    for name, read in _READERS.items():
        path = folder / name
        if path.is_file():
            return path, {_unprefixed(key): array for key, array in read(path).items()}
    raise UserError(f"{folder}: no weights; put {' or '.join(WEIGHT_FILES)} there")


def _unprefixed(key: str) -> str:
    return key.removeprefix(TEXT_PREFIX)


def _is_text(key: str) -> bool:
    """Returns whether a name belongs to the text tower; the position numbers some files hold are no weights."""
    return _unprefixed(key).startswith(_TEXT_PARTS) and not key.endswith(".position_ids")


def _read_safetensors(path: Path) -> StateDict:
    """Returns the arrays of the text tower; those of the image tower are never read."""
    try:
        with safe_open(path, framework="numpy") as file:
            return {key: file.get_tensor(key) for key in file.keys() if _is_text(key)}  # noqa: SIM118 - no mapping
    except (SafetensorError, OSError, ValueError, KeyError, TypeError) as error:
        raise _damaged(path, "safetensors", error) from None


def _read_msgpack(path: Path) -> StateDict:
    """Returns the arrays of a Flax file under PyTorch's names and in PyTorch's axes."""
    try:
        tree = serialization.msgpack_restore(path.read_bytes())
        if not isinstance(tree, dict):
            raise ValueError("it holds no parameters")
        flat = {".".join(names): leaf for names, leaf in traverse_util.flatten_dict(tree).items()}
    except _UNREADABLE as error:
        raise _damaged(path, "msgpack", error) from None
    arrays: StateDict = {}
    for name, leaf in flat.items():
        if not _is_text(name):
            continue
        if not isinstance(leaf, np.ndarray):
            raise UserError(f"{path}: {name!r} is not an array")
        module, _, kind = name.rpartition(".")
        if kind in ("kernel", "embedding", "scale"):
            name = f"{module}.weight"
        arrays[name] = leaf.T if kind == "kernel" else leaf
    return arrays


def _read_torch(path: Path) -> StateDict:
    arrays = {}
    for key, value in load_torch_file(path).items():
        if not _is_text(str(key)):
            continue
        if not isinstance(value, np.ndarray):
            raise UserError(f"{path}: {key!r} is not an array")
        arrays[str(key)] = value
    return arrays


def _damaged(path: Path, kind: str, error: BaseException) -> UserError:
    reason = next(iter(str(error).splitlines()), type(error).__name__)
    return UserError(f"{path}: damaged or not a {kind} file ({reason})")


_READERS: dict[str, Callable[[Path], StateDict]] = {
    "model.safetensors": _read_safetensors,
    "flax_model.msgpack": _read_msgpack,
    "pytorch_model.bin": _read_torch,
}
WEIGHT_FILES = tuple(_READERS)
"""In the order they are looked for."""


def float32_array(path: Path, key: str, array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Returns a weight in 32 bits.

    Raises:
        UserError: if it has not the shape its config wants, or is not made of finite numbers.
    """
    if array.shape != shape:
        raise UserError(f"{path}: array {key!r} has shape {array.shape}, its config wants {shape}")
    if not jnp.issubdtype(array.dtype, jnp.floating):
        raise UserError(f"{path}: array {key!r} holds {array.dtype}, not floating-point numbers")
    with np.errstate(all="ignore"):  # what does not fit is found in the next line
        converted = array.astype(np.float32)
    if not np.all(np.isfinite(converted)):
        raise UserError(f"{path}: array {key!r} has values that are not finite")
    return converted
