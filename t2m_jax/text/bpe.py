"""Subword tokens of captions (byte-pair encoding), by the `tokenizers` library."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Int
from tokenizers import Tokenizer, models, normalizers, pre_tokenizers, trainers

from t2m_jax.errors import UserError
from t2m_jax.files.reading import first_line, load_text
from t2m_jax.files.writing import save_text

PAD = "[pad]"
UNKNOWN = "[unk]"
TOKENIZER_FILE = "tokenizer.json"


class CaptionTokens(NamedTuple):
    """A batch of captions, as the caption encoder reads it."""

    tokens: Int[Array | np.ndarray, "B S"]
    mask: Bool[Array | np.ndarray, "B S"]


def train_bpe(captions: Iterable[str], *, vocabulary_size: int) -> Tokenizer:
    """Returns a lower-casing BPE tokenizer learned from `captions`. Token 0 is padding."""
    tokenizer = Tokenizer(models.BPE(unk_token=UNKNOWN))
    tokenizer.normalizer = normalizers.Sequence([normalizers.NFKC(), normalizers.Lowercase()])
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    # All letters are in the alphabet, so that a prompt can have words that no training caption has.
    alphabet = [chr(code) for code in range(ord("a"), ord("z") + 1)]
    trainer = trainers.BpeTrainer(
        vocab_size=vocabulary_size, special_tokens=[PAD, UNKNOWN], initial_alphabet=alphabet, show_progress=False
    )
    tokenizer.train_from_iterator(captions, trainer)
    return tokenizer


def tokenize_captions(tokenizer: Tokenizer, captions: Sequence[str], *, max_length: int) -> CaptionTokens:
    """Returns tokens, padded to `max_length`. Longer captions are cut."""
    tokens = np.zeros((len(captions), max_length), np.int32)
    mask = np.zeros((len(captions), max_length), bool)
    for number, encoding in enumerate(tokenizer.encode_batch(list(captions))):
        ids = encoding.ids[:max_length]
        tokens[number, : len(ids)] = ids
        mask[number, : len(ids)] = True
    return CaptionTokens(tokens, mask)


def read_part(tokenizer: Tokenizer, caption: str, *, max_length: int) -> str:
    """Returns a caption up to the subword number `max_length`, or all of a shorter one."""
    offsets = tokenizer.encode(caption, add_special_tokens=False).offsets
    return caption if len(offsets) <= max_length else caption[: offsets[max_length - 1][1]]


def save_bpe(folder: Path, tokenizer: Tokenizer) -> None:
    """Writes `tokenizer.json` into `folder`."""
    save_text(folder / TOKENIZER_FILE, tokenizer.to_str())


def load_bpe(folder: Path) -> Tokenizer:
    """Returns the tokenizer of `folder`.

    Raises:
        UserError: The file is missing or is not a tokenizer.
    """
    path = folder / TOKENIZER_FILE
    text = load_text(path)
    try:
        tokenizer = Tokenizer.from_str(text)
    except Exception as error:  # noqa: BLE001 - the library raises nothing narrower for content it cannot read
        raise UserError(f"{path}: not a tokenizer file ({first_line(error)}); copy it again") from None
    if missing := _undefined_tokens(json.loads(tokenizer.to_str())["post_processor"]):
        raise UserError(f"{path}: adds a token {min(missing)[:80]!r}, which it does not define; copy it again")
    return tokenizer


def _undefined_tokens(processor: dict[str, Any] | None) -> set[str]:
    """Returns the tokens that a tokenizer adds and does not define. With one, the library would end the process."""
    if processor is None:
        return set()
    if processor["type"] == "Sequence":
        return set().union(*map(_undefined_tokens, processor["processors"]))
    pieces = [*processor.get("single", []), *processor.get("pair", [])]
    added = {piece["SpecialToken"]["id"] for piece in pieces if "SpecialToken" in piece}
    return added - processor.get("special_tokens", {}).keys()
