"""Files of a CLIP in the Hugging Face layout: where they are, and the arrays of the text tower in them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from flax import serialization, traverse_util
from safetensors import safe_open

from t2m_jax.checkpoints.encoder_files import EncoderFiles, find_encoder
from t2m_jax.checkpoints.torch_file import load_torch_file
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import DAMAGED_WEIGHTS
from t2m_jax.files.reading import first_line, load_json

CONFIG_FILE = "config.json"
TEXT_PREFIX = "text_model."
_TEXT_PARTS = ("embeddings.", "encoder.", "final_layer_norm.", "text_projection.")


def find_clip(name_or_folder: str | Path) -> Path:
    """Returns the folder of a CLIP, see `find_encoder`.

    Raises:
        UserError: There is no such folder, and the hub name cannot be downloaded.
    """
    return find_encoder(name_or_folder, CLIP_FILES)


def read_clip_config(folder: Path) -> dict[str, Any]:
    """Returns the text part of `config.json`, with the `projection_dim` of the whole model.

    Raises:
        UserError: The file is missing or does not describe a CLIP.
    """
    path = folder / CONFIG_FILE
    data = load_json(path)
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


def read_text_arrays(folder: Path) -> tuple[Path, dict[str, np.ndarray]]:
    """Returns the weight file in a CLIP's folder, and the arrays of its text tower by PyTorch's names without prefix.

    Raises:
        UserError: There is no weight file, or it is damaged.
    """
    for name, read in _READERS.items():
        path = folder / name
        if not path.is_file():
            continue
        arrays = {str(key).removeprefix(TEXT_PREFIX): value for key, value in read(path).items() if _is_text(key)}
        for key, value in arrays.items():
            if not isinstance(value, np.ndarray):
                raise UserError(f"{path}: {key!r} is not an array")
        return path, arrays
    raise UserError(f"{folder}: no weights; put {' or '.join(WEIGHT_FILES)} there")


def _is_text(key: str | int) -> bool:
    """Returns whether a name belongs to the text tower; `position_ids` in some files are not weights."""
    name = str(key)
    return name.removeprefix(TEXT_PREFIX).startswith(_TEXT_PARTS) and not name.endswith(".position_ids")


def _read_safetensors(path: Path) -> dict[str, np.ndarray]:
    """Returns the arrays of the text tower; the image tower, which is larger, is not read."""
    try:
        with safe_open(path, framework="numpy") as file:
            return {key: file.get_tensor(key) for key in file.keys() if _is_text(key)}  # noqa: SIM118 - no mapping
    except DAMAGED_WEIGHTS as error:
        raise UserError(f"{path}: damaged or not a safetensors file ({first_line(error)})") from None


def _read_msgpack(path: Path) -> dict[str, Any]:
    """Returns the arrays of a Flax file by PyTorch's names and with PyTorch's order of axes."""
    try:
        flat = traverse_util.flatten_dict(serialization.msgpack_restore(path.read_bytes()))
        leaves = {".".join(names): leaf for names, leaf in flat.items()}
    # Flax uses the contents without checking them, so a hostile file can raise almost anything.
    except (*DAMAGED_WEIGHTS, AssertionError, ArithmeticError, RecursionError, MemoryError) as error:
        raise UserError(f"{path}: damaged or not a msgpack file ({first_line(error)})") from None
    arrays = {}
    for name, leaf in leaves.items():
        module, _, kind = name.rpartition(".")
        is_kernel = kind == "kernel" and isinstance(leaf, np.ndarray)
        arrays[f"{module}.weight" if kind in ("kernel", "embedding", "scale") else name] = leaf.T if is_kernel else leaf
    return arrays


_READERS: dict[str, Callable[[Path], Mapping[Any, Any]]] = {
    "model.safetensors": _read_safetensors,
    "flax_model.msgpack": _read_msgpack,
    "pytorch_model.bin": load_torch_file,
}
WEIGHT_FILES = tuple(_READERS)
"""In the order in which they are tried."""
CLIP_FILES = EncoderFiles(
    kind="clip",
    wanted="the folder of a CLIP or a hub name such as openai/clip-…",
    required=(CONFIG_FILE,),
    tokenizers=(("tokenizer.json",), ("vocab.json", "merges.txt")),
    weights=WEIGHT_FILES,
)
