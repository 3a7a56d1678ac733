"""A small copy of a sentence encoder: matrices in 8 bits, and a vocabulary without other scripts.

The copy is in the same layout as the original, and `load_sentence_encoder` reads both.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from t2m_jax.checkpoints.pretrained import SCALE
from t2m_jax.checkpoints.sentence import (
    CONFIG_FILE,
    LENGTH_FILE,
    MODULES_FILE,
    POOLING_FILE,
    WEIGHTS_FILE,
    load_sentence_encoder,
    used_arrays,
)
from t2m_jax.errors import UserError, naming
from t2m_jax.files.arrays import read_arrays, save_weights
from t2m_jax.files.reading import load_json
from t2m_jax.files.writing import atomic_folder, save_json, save_text
from t2m_jax.text.bpe import TOKENIZER_FILE

NUM_POSITIONS = 128
"""Tokens that a copy reads. Captions of motion have fewer than 60."""
KEPT_CHARACTERS = (range(0x180), range(0x2000, 0x2300))
"""Single characters that are kept: Latin letters, punctuation, and signs such as arrows."""
GROUP = 64
"""Numbers of a row that share a scale. With one scale for a row, some embeddings had a cosine of 0.9975 with the
original; with 64 numbers, the lowest of 1,000 is 0.9993."""
SMALLEST_SCALE = 1e-6
"""Of a row of zeros."""
TOKEN_TABLE = "embeddings.word_embeddings.weight"
POSITION_TABLE = "embeddings.position_embeddings.weight"


def save_compact_encoder(folder: Path, source: Path) -> None:
    """Writes a small copy of a sentence encoder of the BERT family.

    Args:
        folder: Folder to create.
        source: The encoder.

    Raises:
        UserError: It is not such an encoder, or `folder` exists already.
    """
    load_sentence_encoder(source)  # says so if a file is missing or damaged
    tokenizer = load_json(source / TOKENIZER_FILE)
    if tokenizer["model"].get("type") != "WordPiece":
        raise UserError(f"{source / TOKENIZER_FILE}: is not a WordPiece tokenizer; only those can be made smaller")
    special = {token["content"] for token in tokenizer.get("added_tokens", ())}
    kept = kept_tokens(tokenizer["model"]["vocab"], special=special)
    with naming(source / TOKENIZER_FILE):
        words = json.dumps(_renumbered(tokenizer, list(kept)), ensure_ascii=False, separators=(",", ":"))
    arrays = used_arrays(read_arrays(source / WEIGHTS_FILE))
    arrays[TOKEN_TABLE] = arrays[TOKEN_TABLE][list(kept.values())]
    arrays[POSITION_TABLE] = arrays[POSITION_TABLE][:NUM_POSITIONS]
    sizes = {"vocab_size": len(kept), "max_position_embeddings": len(arrays[POSITION_TABLE])}
    length = {"max_seq_length": len(arrays[POSITION_TABLE]), "do_lower_case": False}
    with atomic_folder(folder) as partial:
        (partial / POOLING_FILE).parent.mkdir()
        save_json(partial / CONFIG_FILE, load_json(source / CONFIG_FILE) | sizes)
        for name in (MODULES_FILE, POOLING_FILE):
            save_json(partial / name, load_json(source / name))
        save_json(partial / LENGTH_FILE, length)
        save_text(partial / TOKENIZER_FILE, words)
        save_weights(partial / WEIGHTS_FILE, quantize_rows(arrays))


def kept_tokens(vocabulary: dict[str, int], *, special: set[str]) -> dict[str, int]:
    """Returns the tokens that English sentences need, with their old numbers, in the old order."""

    def is_kept(token: str) -> bool:
        piece = token.removeprefix("##")
        is_character = len(piece) == 1 and any(ord(piece) in codes for codes in KEPT_CHARACTERS)
        return token in special or (not token.startswith("[unused") and (piece.isascii() or is_character))

    return {token: number for token, number in sorted(vocabulary.items(), key=lambda item: item[1]) if is_kept(token)}


def quantize_rows(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns arrays with each matrix as whole numbers from -127 to 127 and a scale for each part of a row."""
    quantized = {}
    for name, array in arrays.items():
        if array.ndim != 2:
            quantized[name] = array
            continue
        width = array.shape[1] if array.shape[1] % GROUP else GROUP
        parts = array.reshape(len(array), -1, width)
        scales = np.maximum(np.abs(parts).max(axis=2) / 127, SMALLEST_SCALE).astype(np.float16)
        numbers = np.rint(parts / scales[:, :, None].astype(np.float32))
        quantized[name] = np.clip(numbers, -127, 127).astype(np.int8).reshape(array.shape)
        quantized[name + SCALE] = scales
    return quantized


def _renumbered(tokenizer: dict[str, Any], tokens: list[str]) -> dict[str, Any]:
    """Returns a tokenizer with some of its tokens, numbered from 0.

    Raises:
        UserError: What adds the marks at both ends of a sentence is of an unknown kind.
    """
    numbers = {token: number for number, token in enumerate(tokens)}
    for token in tokenizer.get("added_tokens", ()):
        token["id"] = numbers[token["content"]]
    marks = tokenizer["post_processor"]
    if marks["type"] == "TemplateProcessing":
        for token in marks["special_tokens"].values():
            token["ids"] = [numbers[name] for name in token["tokens"]]
    elif marks["type"] == "BertProcessing":
        marks |= {end: [marks[end][0], numbers[marks[end][0]]] for end in ("cls", "sep")}
    else:
        raise UserError(f"adds marks to sentences by {marks['type']}; it cannot be made smaller")
    # The encoder pads and cuts captions itself.
    model = tokenizer["model"] | {"vocab": numbers}
    return tokenizer | {"model": model, "padding": None, "truncation": None}
