"""Subword tokens of captions (byte-pair encoding), our own and those of CLIP, by the `tokenizers` library."""

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Int
from tokenizers import Tokenizer, models, normalizers, pre_tokenizers, trainers

from t2m_jax.errors import UserError
from t2m_jax.files.reading import first_line, load_json
from t2m_jax.files.writing import save_text

PAD = "[pad]"
UNKNOWN = "[unk]"
TOKENIZER_FILE = "tokenizer.json"
CLIP_START = "<|startoftext|>"
CLIP_END = "<|endoftext|>"
MAX_TOKEN = 1_000_000
"""Largest number of a token; vocabularies of all languages have a quarter as many."""


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


def clip_tokens(tokenizer: Tokenizer, captions: Sequence[str], *, max_length: int) -> Int[np.ndarray, "B S"]:
    """Returns a start token, the caption, and end tokens up to `max_length`.

    A longer caption loses its last tokens, but never the end token, as in `clip.tokenize(…, truncate=True)`. That
    function also repairs HTML entities and broken encodings. This one does not: the captions of the published data
    sets have none.
    """
    start, end = map(tokenizer.token_to_id, (CLIP_START, CLIP_END))
    assert start is not None and end is not None, "the tokenizer is not CLIP's"
    tokens = np.full((len(captions), max_length), end, np.int32)
    tokens[:, 0] = start
    for number, encoding in enumerate(tokenizer.encode_batch(list(captions), add_special_tokens=False)):
        # Two places are for the start and the end.
        ids = encoding.ids[: max_length - 2]
        tokens[number, 1 : 1 + len(ids)] = ids
    return tokens


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
        UserError: The file is missing, is not a tokenizer, or has a token of a very large number.
    """
    path = folder / TOKENIZER_FILE
    tree = load_json(path)
    if not isinstance(tree, dict):
        raise UserError(f"{path}: not a tokenizer file (it is not an object); copy it again")
    # Before the library reads it: it would make a table of as many tokens as the largest number.
    if (largest := max(_token_ids(tree), default=0)) > MAX_TOKEN:
        raise UserError(f"{path}: has a token {largest}; at most {MAX_TOKEN:,} are read; copy it again")
    try:
        # Not the text of the file: in one with two objects of a name, the library could read the other one.
        tokenizer = Tokenizer.from_str(json.dumps(tree))
    except Exception as error:  # noqa: BLE001 - the library raises nothing narrower for content it cannot read
        raise UserError(f"{path}: not a tokenizer file ({first_line(error)}); copy it again") from None
    if missing := _undefined_tokens(json.loads(tokenizer.to_str())["post_processor"]):
        raise UserError(f"{path}: adds a token {min(missing)[:80]!r}, which it does not define; copy it again")
    # Of its last use. Whoever needs it does it again; the file could ask for any length.
    tokenizer.no_padding()
    return tokenizer


def load_clip_bpe(folder: Path) -> Tokenizer:
    """Returns the tokenizer of a CLIP's folder.

    Raises:
        UserError: The folder has none, or it is not CLIP's.
    """
    tokenizer = load_bpe(folder)
    for special in (CLIP_START, CLIP_END):
        if tokenizer.token_to_id(special) is None:
            raise UserError(f"{folder / TOKENIZER_FILE}: has no token {special!r}; give the tokenizer of a CLIP")
    # `clip_tokens` cuts. The file may still contain the settings of its last use.
    tokenizer.no_truncation()
    return tokenizer


def largest_token(tokenizer: Tokenizer) -> int:
    """Returns the largest number that a tokenizer gives to a token, also to one that it only adds."""
    return max(_token_ids(json.loads(tokenizer.to_str())), default=0)


def _token_ids(tree: Any) -> Iterator[int]:
    """Yields the numbers of tokens in the data of a tokenizer, or what stands in their place."""
    model = tree.get("model")
    vocabulary = model.get("vocab") if isinstance(model, dict) else None
    if isinstance(vocabulary, list):  # of Unigram: a token's number is its place
        yield len(vocabulary) - 1
    yield from _numbers(vocabulary if isinstance(vocabulary, dict) else None)
    yield from _numbers(tree.get("added_tokens"))
    yield from _numbers(tree.get("post_processor"))


def _numbers(tree: Any) -> Iterator[int]:
    """Yields all whole numbers in nested data."""
    waiting = [tree]
    while waiting:
        part = waiting.pop()
        if isinstance(part, (dict, list)):
            waiting += part.values() if isinstance(part, dict) else part
        elif type(part) is int:
            yield part


def _undefined_tokens(processor: dict[str, Any] | None) -> set[str]:
    """Returns the tokens that a tokenizer adds and does not define. With one, the library would end the process."""
    if processor is None:
        return set()
    if processor["type"] == "Sequence":
        return set().union(*map(_undefined_tokens, processor["processors"]))
    pieces = [*processor.get("single", []), *processor.get("pair", [])]
    added = {piece["SpecialToken"]["id"] for piece in pieces if "SpecialToken" in piece}
    return added - processor.get("special_tokens", {}).keys()
