"""A trained sentence encoder of the BERT family, from a folder in the layout of the library `sentence-transformers`."""

import re
import reprlib
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from tokenizers import Tokenizer, normalizers

from t2m_jax.checkpoints.encoder_files import EncoderFiles, find_encoder
from t2m_jax.checkpoints.pretrained import (
    check_vocabulary,
    encoder_fingerprint,
    param_shapes,
    params_from_torch,
    restore_rows,
)
from t2m_jax.config import config_from_dict
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import read_arrays
from t2m_jax.files.reading import load_json
from t2m_jax.models.sentence_encoder import SentenceEncoder, SentenceEncoderConfig
from t2m_jax.text.bpe import TOKENIZER_FILE, load_bpe

CONFIG_FILE = "config.json"
WEIGHTS_FILE = "model.safetensors"
MODULES_FILE = "modules.json"
POOLING_FILE = "1_Pooling/config.json"
LENGTH_FILE = "sentence_bert_config.json"
PROMPTS_FILE = "config_sentence_transformers.json"
TOKENIZER_CONFIG_FILE = "tokenizer_config.json"
SENTENCE_FILES = EncoderFiles(
    kind="sentence",
    wanted="the folder of a sentence encoder or a hub name such as sentence-transformers/…",
    required=(CONFIG_FILE, MODULES_FILE, POOLING_FILE, TOKENIZER_FILE),
    weights=(WEIGHTS_FILE,),
    optional=(LENGTH_FILE, PROMPTS_FILE, TOKENIZER_CONFIG_FILE),
)

_BERT = "bert"
_MPNET = "mpnet"
_ROBERTA = ("roberta", "xlm-roberta", "camembert")
"""Values of `model_type`, as those above."""
_PLACES = ["", "1_Pooling"]
"""Folders of the first steps."""
_POSITIONS = "max_position_embeddings"
_FIELDS = {
    "vocab_size": "vocabulary_size",
    _POSITIONS: "num_positions",
    "type_vocab_size": "num_types",
    "relative_attention_num_buckets": "num_buckets",
    "hidden_size": "embed_dim",
    "num_hidden_layers": "num_layers",
    "num_attention_heads": "num_heads",
    "intermediate_size": "mlp_dim",
    "hidden_act": "activation",
    "layer_norm_eps": "layer_norm_epsilon",
}
"""Hugging Face's names of the config's fields. The defaults are the same as ours."""
_SWITCH = "pooling_mode_"
_SWITCHES = {"cls_token": "cls", "mean_tokens": "mean"}
"""Older files have `pooling_mode_cls_token: true` instead of `pooling_mode: cls`."""

_NAMES = {
    "token_embedding": "embeddings.word_embeddings.weight",
    "position_embedding": "embeddings.position_embeddings.weight",
    "type_embedding": "embeddings.token_type_embeddings.weight",
    "distance_bias": "encoder.relative_attention_bias.weight",
    "embedding_norm": "embeddings.LayerNorm",
    "attn": "attention",
    "query": "self.query",
    "key": "self.key",
    "value": "self.value",
    "proj": "output.dense",
    "ln1": "attention.output.LayerNorm",
    "up": "intermediate.dense",
    "down": "output.dense",
    "ln2": "output.LayerNorm",
    "kernel": "weight",
    "scale": "weight",
    "bias": "bias",
}
"""PyTorch's names of the parts of our parameter paths."""
_MPNET_NAMES = {
    "query": "attn.q",
    "key": "attn.k",
    "value": "attn.v",
    "proj": "attn.o",
    "ln1": "attention.LayerNorm",
}
"""The names that MPNet has instead."""


class TrainedSentenceEncoder(NamedTuple):
    """A sentence encoder and the tokenizer that it was trained with, which adds special tokens and cuts captions."""

    folder: Path
    config: SentenceEncoderConfig
    variables: dict[str, Any]
    tokenizer: Tokenizer
    fingerprint: str
    """Identifies the model: embeddings of two fingerprints cannot be mixed."""


def load_sentence_encoder(name_or_folder: str | Path) -> TrainedSentenceEncoder:
    """Returns a sentence encoder, from a folder or by a hub name such as `sentence-transformers/all-MiniLM-L6-v2`.

    Raises:
        UserError: It cannot be found, is of another family, or a file is missing or damaged.
    """
    folder = find_encoder(name_or_folder, SENTENCE_FILES)
    config = read_sentence_config(folder)
    tokenizer = load_sentence_tokenizer(folder, config)
    variables = {"params": _load_params(folder / WEIGHTS_FILE, config)}
    fingerprint = encoder_fingerprint(config, variables, tokenizer)
    return TrainedSentenceEncoder(folder, config, variables, tokenizer, fingerprint)


def save_sentence_encoder(folder: Path, encoder: TrainedSentenceEncoder) -> None:
    """Copies the files of a sentence encoder."""
    (folder / POOLING_FILE).parent.mkdir(parents=True)
    # Copied, not written again: we read less than is in the files, and other libraries may need the rest.
    for name in (*SENTENCE_FILES.required, *SENTENCE_FILES.weights, *SENTENCE_FILES.optional):
        if (encoder.folder / name).is_file():
            shutil.copyfile(encoder.folder / name, folder / name)


def read_sentence_config(folder: Path) -> SentenceEncoderConfig:
    """Returns the sizes of an encoder, and how it makes one embedding of a caption.

    Raises:
        UserError: A file is missing or damaged, or describes what is not supported.
    """
    path = folder / CONFIG_FILE
    data = _load_section(path)
    kind = data.get("model_type")
    if kind not in (known := (_BERT, *_ROBERTA, _MPNET)):
        raise UserError(f"{path}: model_type {reprlib.repr(kind)} is not supported; known: {', '.join(known)}")
    if data.get("position_embedding_type", "absolute") != "absolute":
        raise UserError(f"{path}: position_embedding_type must be 'absolute'; other kinds are not supported")
    fields = {ours: data[theirs] for theirs, ours in _FIELDS.items() if theirs in data}
    # RoBERTa counts positions from the one after its padding token. MPNet does so, too, and always has padding token 1.
    fields["first_position"] = (
        0 if kind == _BERT else 2 if kind == _MPNET else _whole(path, data, "pad_token_id", 1) + 1
    )
    # MPNet has a bias by the distance of tokens, which is in 32 classes if the file does not say, and no kinds of
    # sentences.
    if kind == _MPNET:
        fields = {"num_buckets": 32, **fields, "num_types": 0}
    fields["max_length"] = min(_max_length(folder), _whole(path, data, _POSITIONS, 512) - fields["first_position"])
    fields |= {"normalize": _read_modules(folder), "pooling": _read_pooling(folder)}
    return config_from_dict(SentenceEncoderConfig, fields, source=f"{path}")


def _read_modules(folder: Path) -> bool:
    """Returns whether the last step of an encoder is a normalization."""
    path = folder / MODULES_FILE
    modules = load_json(path)
    rows = [row if isinstance(row, dict) else {} for row in modules] if isinstance(modules, list) else []
    names = [str(row.get("type")).rpartition(".")[2] for row in rows]
    places = [row.get("path") for row in rows[:2]]
    if names[:2] != ["Transformer", "Pooling"] or names[2:] not in ([], ["Normalize"]) or places != _PLACES:
        raise UserError(
            f"{path}: expected Transformer, Pooling (in 1_Pooling) and perhaps Normalize, got {', '.join(names)[:80]}; "
            "other steps are not supported"
        )
    # Such a prompt is put before each text, and embeddings without it would be others than the library's.
    if _load_optional(folder / PROMPTS_FILE).get("default_prompt_name") is not None:
        raise UserError(f"{folder / PROMPTS_FILE}: has a default prompt, which is not supported")
    return len(names) > 2


def _read_pooling(folder: Path) -> Any:
    """Returns what is read: `mean` or `cls`. Older files have a switch for each kind."""
    path = folder / POOLING_FILE
    data = _load_section(path)
    switched = [
        name.removeprefix(_SWITCH) for name, value in data.items() if name.startswith(_SWITCH) and value is True
    ]
    kinds = data.get("pooling_mode", [_SWITCHES.get(name, name) for name in switched])
    if kinds not in ("mean", "cls", ["mean"], ["cls"]):
        raise UserError(f"{path}: the kind of pooling must be mean or cls, not {reprlib.repr(kinds)}")
    return kinds if isinstance(kinds, str) else kinds[0]


def _max_length(folder: Path) -> int:
    """Returns the number of tokens that are read, special ones included, as far as files limit it."""
    # In the library's order: its own limit wins over that of the tokenizer.
    for name, field in ((LENGTH_FILE, "max_seq_length"), (TOKENIZER_CONFIG_FILE, "model_max_length")):
        data = _load_optional(folder / name)
        if data.get(field) is not None:
            return _whole(folder / name, data, field, 0)
    return sys.maxsize


def load_sentence_tokenizer(folder: Path, config: SentenceEncoderConfig) -> Tokenizer:
    """Returns the tokenizer, which adds special tokens and cuts captions, but does not pad them.

    Raises:
        UserError: The file is missing or damaged, or does not fit the config.
    """
    tokenizer = load_bpe(folder)
    path = folder / TOKENIZER_FILE
    check_vocabulary(path, tokenizer, config.vocabulary_size)
    # A caption without any token would have no embedding.
    if not 0 < (special := tokenizer.num_special_tokens_to_add(False)) < config.max_length:
        raise UserError(
            f"{path}: adds {special} special tokens; expected at least 1, and fewer than {config.max_length}"
        )
    # The library does this itself, before its tokenizer.
    if _load_optional(folder / LENGTH_FILE).get("do_lower_case") is True:
        others = [] if tokenizer.normalizer is None else [tokenizer.normalizer]
        tokenizer.normalizer = normalizers.Sequence([normalizers.Lowercase(), *others])
    tokenizer.enable_truncation(config.max_length)
    return tokenizer


def used_arrays(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns the arrays of a file that are weights of the encoder, by their names in a file of the encoder alone."""
    # Files of a network with a head for another task have its family's name before the names of the encoder.
    named = {re.sub(r"^(bert|roberta|mpnet)\.", "", key): array for key, array in arrays.items()}
    # Some files have numbers of positions and of kinds, which are not weights.
    return {
        key: a for key, a in named.items() if key.startswith(("embeddings.", "encoder.")) and not key.endswith("_ids")
    }


def _load_params(path: Path, config: SentenceEncoderConfig) -> dict[str, Any]:
    """Returns the parameters of `SentenceEncoder`. What other uses of the network need is not read."""
    used = restore_rows(path, used_arrays(read_arrays(path)))
    names = _NAMES | _MPNET_NAMES if config.num_buckets else _NAMES

    def key_from_path(path: tuple[str, ...]) -> str:
        return ".".join(names.get(part) or part.replace("block_", "encoder.layer.") for part in path)

    tokens = jnp.zeros((1, 1), jnp.int32)
    shapes = param_shapes(SentenceEncoder(config), tokens, tokens == 0)
    return params_from_torch(path, used, shapes, key_from_path)


def _load_section(path: Path) -> dict[str, Any]:
    data = load_json(path)
    if not isinstance(data, dict):
        raise UserError(f"{path}: expected an object, got {reprlib.repr(data)}")
    return data


def _load_optional(path: Path) -> dict[str, Any]:
    return _load_section(path) if path.is_file() else {}


def _whole(path: Path, data: Mapping[str, Any], name: str, default: int) -> int:
    """Returns a whole number of a file."""
    value = data.get(name, default)
    if type(value) is not int:
        raise UserError(f"{path}: {name}: expected a whole number, got {reprlib.repr(value)}")
    return value
