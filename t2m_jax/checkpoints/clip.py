"""A trained CLIP text tower: loaded from, and saved in, the Hugging Face layout."""

import dataclasses
import hashlib
import json
import re
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from flax import traverse_util
from safetensors.numpy import save_file
from tokenizers import Tokenizer

from t2m_jax.checkpoints.clip_files import (
    CONFIG_FILE,
    TEXT_PREFIX,
    WEIGHT_FILES,
    StateDict,
    find_clip,
    float32_array,
    read_clip_config,
    read_text_arrays,
)
from t2m_jax.config import config_from_dict
from t2m_jax.errors import UserError
from t2m_jax.models.clip_text import ClipTextConfig
from t2m_jax.text.bpe import save_bpe
from t2m_jax.text.clip_bpe import END, START, load_clip_bpe

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
"""Hugging Face's names of the config's fields; their defaults are ours, ViT-B/32."""

_END_FIELD, _LEGACY_END, _DEFAULT_END = "eos_token_id", 2, 49407
"""Early configs say 2, which no vocabulary means: such a CLIP is read at the largest token, as it was trained."""

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
    """A CLIP text tower and the tokenizer it was trained with."""

    config: ClipTextConfig
    variables: dict[str, Any]
    tokenizer: Tokenizer
    fingerprint: str
    """Tells this model's embeddings from those of any other."""


def load_clip(name_or_folder: str | Path, *, text_dim: int | None = None) -> TrainedClip:
    """Returns the text tower of a CLIP, from a folder or by a hub name such as `openai/clip-vit-base-patch32`.

    Args:
        name_or_folder: Where it is.
        text_dim: Width of the embeddings that a GPT reads, where there is one.

    Raises:
        UserError: if it cannot be found, is of another width, or a file is missing, damaged or does not fit the others.
    """
    folder = find_clip(name_or_folder)
    config = _load_config(folder)
    if text_dim not in (None, config.text_dim):
        raise UserError(f"{name_or_folder}: embeddings of {config.text_dim} numbers, but the GPT wants {text_dim}")
    tokenizer = load_clip_bpe(folder)
    _check_tokenizer(folder, config, tokenizer)
    path, arrays = read_text_arrays(folder)
    variables = {"params": _params_from_arrays(path, arrays, config)}
    return TrainedClip(config, variables, tokenizer, clip_fingerprint(config, variables, tokenizer))


def save_clip(folder: Path, clip: TrainedClip, *, half: bool = False) -> None:
    """Writes `config.json`, `model.safetensors` and `tokenizer.json`; with `half` the weights take 16 bits each."""
    folder.mkdir(parents=True, exist_ok=True)
    fields = dataclasses.asdict(clip.config)
    end_token = fields.pop("end_token")
    data: dict[str, Any] = {"architectures": ["CLIPTextModelWithProjection"], "model_type": "clip_text_model"}
    data |= {theirs: fields[ours] for theirs, ours in _FIELDS.items()}
    data[_END_FIELD] = _LEGACY_END if end_token is None else end_token
    data["bos_token_id"] = clip.tokenizer.token_to_id(START)
    (folder / CONFIG_FILE).write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
    save_bpe(folder, clip.tokenizer)
    flat = traverse_util.flatten_dict(jax.device_get(clip.variables["params"]))
    arrays = {}
    for names, leaf in flat.items():
        array = leaf.T if names[-1] == "kernel" else leaf
        key = _key_from_path(names)
        key = key if key.startswith(_NAMES["projection"]) else TEXT_PREFIX + key
        arrays[key] = np.ascontiguousarray(array, np.float16 if half else np.float32)
    save_file(arrays, folder / WEIGHT_FILES[0], metadata={"format": "pt"})
    (folder / WEIGHT_FILES[0]).chmod(0o644)  # safetensors makes its files private; a model is made to be shared


def clip_fingerprint(config: ClipTextConfig, variables: dict[str, Any], tokenizer: Tokenizer) -> str:
    """Returns a hash of everything that an embedding depends on."""
    digest = hashlib.sha256(f"{config}\n{tokenizer.to_str()}\n".encode())
    for name, leaf in sorted(traverse_util.flatten_dict(variables, sep="/").items()):
        array = np.ascontiguousarray(leaf, "<f4")
        digest.update(f"{name} {array.shape}\n".encode() + array.tobytes())
    return digest.hexdigest()


def _load_config(folder: Path) -> ClipTextConfig:
    data = read_clip_config(folder)
    fields = {ours: data[theirs] for theirs, ours in _FIELDS.items() if theirs in data}
    end_token = data.get(_END_FIELD, _DEFAULT_END)
    fields["end_token"] = None if end_token == _LEGACY_END else end_token
    return config_from_dict(ClipTextConfig, fields, source=f"{folder / CONFIG_FILE}")


def _check_tokenizer(folder: Path, config: ClipTextConfig, tokenizer: Tokenizer) -> None:
    """Raises `UserError` where the tokenizer's numbers are not those of the model."""
    largest = max(tokenizer.get_vocab(with_added_tokens=True).values())
    if largest >= config.vocabulary_size:
        raise UserError(f"{folder}: the tokenizer has a token {largest}, vocab_size is {config.vocabulary_size}")
    end = tokenizer.token_to_id(END)
    if config.end_token not in (None, end):
        raise UserError(f"{folder}: {END!r} is token {end}, but {CONFIG_FILE} says {_END_FIELD} {config.end_token}")


def _params_from_arrays(path: Path, arrays: StateDict, config: ClipTextConfig) -> dict[str, Any]:
    """Returns the parameters of `ClipText`, having checked names, shapes and values."""
    layers = {int(found[1]) for key in arrays if (found := re.match(r"encoder\.layers\.(\d{1,6})\.", key))}
    if len(layers) != config.num_layers:  # first, because the table below has a row for each of them
        raise UserError(f"{path}: has {len(layers)} layers, its config wants {config.num_layers}")
    if "text_projection.weight" not in arrays:
        raise UserError(
            f"{path}: array 'text_projection.weight' is missing; a CLIP is needed that was saved with its projection"
        )
    shapes = param_shapes(config)
    wanted = {_key_from_path(names): names for names in shapes}
    for key in sorted(wanted.keys() ^ arrays.keys()):
        kind = "is missing" if key in wanted else "is not part of the model its config describes"
        raise UserError(f"{path}: array {key!r} {kind}")
    flat = {}
    for key, names in wanted.items():
        is_kernel = names[-1] == "kernel"
        array = float32_array(path, key, arrays[key], shapes[names][::-1] if is_kernel else shapes[names])
        flat[names] = array.T if is_kernel else array
    return traverse_util.unflatten_dict(flat)


def param_shapes(config: ClipTextConfig) -> dict[tuple[str, ...], tuple[int, ...]]:
    """Returns the shape of every parameter of `ClipText` by its path, without making one: configs may be absurd."""
    width, mlp = config.embed_dim, config.mlp_dim

    def dense(*path: str, inputs: int, outputs: int) -> dict[tuple[str, ...], tuple[int, ...]]:
        return {(*path, "kernel"): (inputs, outputs), (*path, "bias"): (outputs,)}

    shapes: dict[tuple[str, ...], tuple[int, ...]] = {
        ("token_embedding", "embedding"): (config.vocabulary_size, width),
        ("position_embedding",): (config.max_length, width),
        ("projection", "kernel"): (width, config.text_dim),
    }
    norms: list[tuple[str, ...]] = [("final_norm",)]
    for layer in range(config.num_layers):
        block = f"block_{layer}"
        norms += [(block, "ln1"), (block, "ln2")]
        for name in ("query", "key", "value", "proj"):
            shapes |= dense(block, "attn", name, inputs=width, outputs=width)
        shapes |= dense(block, "up", inputs=width, outputs=mlp) | dense(block, "down", inputs=mlp, outputs=width)
    for path in norms:
        shapes |= {(*path, "scale"): (width,), (*path, "bias"): (width,)}
    return shapes


def _key_from_path(names: tuple[str, ...]) -> str:
    """Returns PyTorch's name of one of our parameters, without the prefix."""
    return ".".join(_NAMES.get(name) or name.replace("block_", "encoder.layers.") for name in names)
