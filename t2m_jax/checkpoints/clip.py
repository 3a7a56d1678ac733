"""A trained CLIP text tower: loaded from, and saved in, the Hugging Face layout."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import traverse_util
from safetensors import safe_open
from tokenizers import Tokenizer

from t2m_jax.checkpoints.encoder_files import EncoderFiles, find_encoder
from t2m_jax.checkpoints.pretrained import check_vocabulary, encoder_fingerprint, param_shapes, params_from_torch
from t2m_jax.checkpoints.torch_file import load_torch_file
from t2m_jax.config import config_from_dict
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import DAMAGED_WEIGHTS, save_weights
from t2m_jax.files.reading import first_line, load_json
from t2m_jax.files.writing import save_json
from t2m_jax.models.clip_text import ClipText, ClipTextConfig
from t2m_jax.text.bpe import CLIP_END, CLIP_START, TOKENIZER_FILE, load_clip_bpe, save_bpe

CONFIG_FILE = "config.json"
WEIGHTS_FILE = "model.safetensors"
TEXT_PREFIX = "text_model."
_TEXT_PARTS = ("embeddings.", "encoder.", "final_layer_norm.", "text_projection.")
_FIELDS = {
    "vocab_size": "vocabulary_size",
    "max_position_embeddings": "max_length",
    "hidden_size": "embed_dim",
    "num_hidden_layers": "num_layers",
    "num_attention_heads": "num_heads",
    "intermediate_size": "mlp_dim",
    "hidden_act": "activation",
    "layer_norm_eps": "layer_norm_epsilon",
    "projection_dim": "text_dim",
}
"""Hugging Face's names of the config's fields. The defaults are the same as ours: ViT-B/32."""

_END_FIELD = "eos_token_id"
_DEFAULT_END = 49407
"""The value of a config that does not have the field, as in `transformers`."""
_LEGACY_END = 2
"""Early configs say this, which is wrong for every vocabulary. Such a CLIP was trained to read the largest token."""

_NAMES = {
    "token_embedding": "embeddings.token_embedding",
    "position_embedding": "embeddings.position_embedding.weight",
    "final_norm": "final_layer_norm",
    "projection": "text_projection",
    "ln1": "layer_norm1",
    "ln2": "layer_norm2",
    "attn": "self_attn",
    "query": "q_proj",
    "key": "k_proj",
    "value": "v_proj",
    "proj": "out_proj",
    "up": "mlp.fc1",
    "down": "mlp.fc2",
    "kernel": "weight",
    "scale": "weight",
    "embedding": "weight",
    "bias": "bias",
}
"""PyTorch's names of the parts of our parameter paths."""


class TrainedClip(NamedTuple):
    """A CLIP text tower and the tokenizer that it was trained with."""

    config: ClipTextConfig
    variables: dict[str, Any]
    tokenizer: Tokenizer
    fingerprint: str
    """Identifies the model: embeddings of two fingerprints cannot be mixed."""


def load_clip(name_or_folder: str | Path) -> TrainedClip:
    """Returns the text tower of a CLIP, from a folder or by a hub name such as `openai/clip-vit-base-patch32`.

    Raises:
        UserError: It cannot be found, or a file is missing, damaged or does not fit the others.
    """
    folder = find_encoder(name_or_folder, CLIP_FILES)
    data = read_clip_config(folder)
    end_token = data.get(_END_FIELD, _DEFAULT_END)
    fields = {ours: data[theirs] for theirs, ours in _FIELDS.items() if theirs in data}
    fields["end_token"] = None if end_token == _LEGACY_END else end_token
    config = config_from_dict(ClipTextConfig, fields, source=f"{folder / CONFIG_FILE}")
    tokenizer = load_clip_bpe(folder)
    check_vocabulary(folder, tokenizer, config.vocabulary_size)
    end = tokenizer.token_to_id(CLIP_END)
    if config.end_token not in (None, end):
        raise UserError(f"{folder}: {CLIP_END!r} is token {end}, but config.json says {_END_FIELD} {config.end_token}")
    path, arrays = _read_text_arrays(folder)
    # Some files are saved without it. Their embeddings are in another space than those that the GPT was trained on.
    if "text_projection.weight" not in arrays:
        raise UserError(f"{path}: array 'text_projection.weight' is missing; give a CLIP saved with its projection")
    shapes = param_shapes(ClipText(config), jnp.zeros((1, config.max_length), jnp.int32))
    variables = {"params": params_from_torch(path, arrays, shapes, _key_from_path)}
    return TrainedClip(config, variables, tokenizer, encoder_fingerprint(config, variables, tokenizer))


def save_clip(folder: Path, clip: TrainedClip) -> None:
    """Writes `config.json`, `model.safetensors` and `tokenizer.json`."""
    folder.mkdir(parents=True, exist_ok=True)
    fields = dataclasses.asdict(clip.config)
    end_token = fields.pop("end_token")
    data: dict[str, Any] = {"architectures": ["CLIPTextModelWithProjection"], "model_type": "clip_text_model"}
    data |= {theirs: fields[ours] for theirs, ours in _FIELDS.items()}
    data[_END_FIELD] = _LEGACY_END if end_token is None else end_token
    data["bos_token_id"] = clip.tokenizer.token_to_id(CLIP_START)
    save_json(folder / CONFIG_FILE, data)
    save_bpe(folder, clip.tokenizer)
    arrays = {}
    for names, leaf in traverse_util.flatten_dict(jax.device_get(clip.variables["params"])).items():
        key = _key_from_path(names)
        key = key if key.startswith(_NAMES["projection"]) else TEXT_PREFIX + key
        array = leaf.T if names[-1] == "kernel" else leaf
        arrays[key] = np.ascontiguousarray(array, np.float32)
    save_weights(folder / WEIGHTS_FILE, arrays, metadata={"format": "pt"})


def _key_from_path(names: tuple[str, ...]) -> str:
    """Returns PyTorch's name of one of our parameters, without the prefix."""
    return ".".join(_NAMES.get(name) or name.replace("block_", "encoder.layers.") for name in names)


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


def _read_text_arrays(folder: Path) -> tuple[Path, dict[str, np.ndarray]]:
    """Returns the weight file in a CLIP's folder, and the arrays of its text tower by PyTorch's names without prefix.

    Raises:
        UserError: There is no weight file, or it is damaged.
    """
    path = next((folder / name for name in _READERS if (folder / name).is_file()), None)
    if path is None:
        raise UserError(f"{folder}: no weights; put {' or '.join(_READERS)} there")
    found = _READERS[path.name](path)
    arrays = {str(key).removeprefix(TEXT_PREFIX): value for key, value in found.items() if _is_text(key)}
    for key, value in arrays.items():
        if not isinstance(value, np.ndarray):
            raise UserError(f"{path}: {key!r} is not an array")
    return path, arrays


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


_READERS: dict[str, Callable[[Path], Mapping[Any, Any]]] = {
    WEIGHTS_FILE: _read_safetensors,
    "pytorch_model.bin": load_torch_file,
}
"""Files of weights in the order in which they are tried."""
CLIP_FILES = EncoderFiles(
    kind="clip",
    wanted="the folder of a CLIP or a hub name such as openai/clip-…",
    required=(CONFIG_FILE, TOKENIZER_FILE),
    weights=tuple(_READERS),
)
