"""A trained CLIP text tower: loaded from, and saved in, the Hugging Face layout."""

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import traverse_util
from tokenizers import Tokenizer

from t2m_jax.checkpoints import clip_files
from t2m_jax.checkpoints.pretrained import check_vocabulary, encoder_fingerprint, params_from_torch
from t2m_jax.config import config_from_dict
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import save_weights
from t2m_jax.files.writing import save_json
from t2m_jax.keys import new_key
from t2m_jax.models.clip_text import ClipText, ClipTextConfig
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


def load_clip(name_or_folder: str | Path, *, text_dim: int | None = None) -> TrainedClip:
    """Returns the text tower of a CLIP, from a folder or by a hub name such as `openai/clip-vit-base-patch32`.

    Args:
        name_or_folder: The folder or the name.
        text_dim: Width of the embeddings that the GPT reads, if there is a GPT.

    Raises:
        UserError: It cannot be found, has another width, or a file is missing, damaged or does not fit the others.
    """
    folder = clip_files.find_clip(name_or_folder)
    data = clip_files.read_clip_config(folder)
    end_token = data.get(_END_FIELD, _DEFAULT_END)
    fields = {ours: data[theirs] for theirs, ours in _FIELDS.items() if theirs in data}
    fields["end_token"] = None if end_token == _LEGACY_END else end_token
    config = config_from_dict(ClipTextConfig, fields, source=f"{folder / clip_files.CONFIG_FILE}")
    if text_dim not in (None, config.text_dim):
        raise UserError(f"{name_or_folder}: has embeddings of {config.text_dim} numbers, but the GPT reads {text_dim}")
    tokenizer = load_clip_bpe(folder)
    check_vocabulary(folder, tokenizer, config.vocabulary_size)
    end = tokenizer.token_to_id(END)
    if config.end_token not in (None, end):
        raise UserError(f"{folder}: {END!r} is token {end}, but config.json says {_END_FIELD} {config.end_token}")
    path, arrays = clip_files.read_text_arrays(folder)
    # Some files are saved without it. Their embeddings are in another space than those that the GPT was trained on.
    if "text_projection.weight" not in arrays:
        raise UserError(f"{path}: array 'text_projection.weight' is missing; give a CLIP saved with its projection")
    variables = {"params": params_from_torch(path, arrays, param_shapes(config), _key_from_path)}
    return TrainedClip(config, variables, tokenizer, encoder_fingerprint(config, variables, tokenizer))


def save_clip(folder: Path, clip: TrainedClip, *, half: bool = False) -> None:
    """Writes `config.json`, `model.safetensors` and `tokenizer.json`; with `half` the weights take 16 bits each."""
    folder.mkdir(parents=True, exist_ok=True)
    fields = dataclasses.asdict(clip.config)
    end_token = fields.pop("end_token")
    data: dict[str, Any] = {"architectures": ["CLIPTextModelWithProjection"], "model_type": "clip_text_model"}
    data |= {theirs: fields[ours] for theirs, ours in _FIELDS.items()}
    data[_END_FIELD] = _LEGACY_END if end_token is None else end_token
    data["bos_token_id"] = clip.tokenizer.token_to_id(START)
    save_json(folder / clip_files.CONFIG_FILE, data)
    save_bpe(folder, clip.tokenizer)
    arrays = {}
    for names, leaf in traverse_util.flatten_dict(jax.device_get(clip.variables["params"])).items():
        key = _key_from_path(names)
        key = key if key.startswith(_NAMES["projection"]) else clip_files.TEXT_PREFIX + key
        array = leaf.T if names[-1] == "kernel" else leaf
        arrays[key] = np.ascontiguousarray(array, np.float16 if half else np.float32)
    save_weights(folder / clip_files.WEIGHT_FILES[0], arrays, metadata={"format": "pt"})


def param_shapes(config: ClipTextConfig) -> dict[tuple[str, ...], tuple[int, ...]]:
    """Returns the shape of every parameter of `ClipText` by its path."""
    tokens = jnp.zeros((1, config.max_length), jnp.int32)
    params = jax.eval_shape(lambda: ClipText(config).init(new_key(0), tokens))["params"]
    return {names: leaf.shape for names, leaf in traverse_util.flatten_dict(params).items()}


def _key_from_path(names: tuple[str, ...]) -> str:
    """Returns PyTorch's name of one of our parameters, without the prefix."""
    return ".".join(_NAMES.get(name) or name.replace("block_", "encoder.layers.") for name in names)
