"""Captions as CLIP reads them: its byte-level BPE, by the `tokenizers` library."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int
from tokenizers import AddedToken, Regex, Tokenizer, decoders, models, normalizers, pre_tokenizers

from t2m_jax.errors import UserError
from t2m_jax.text.bpe import TOKENIZER_FILE, load_bpe

START, END = "<|startoftext|>", "<|endoftext|>"
END_OF_WORD = "</w>"
VOCABULARY_FILE, MERGES_FILE = "vocab.json", "merges.txt"

# English endings, runs of letters, single digits, runs of anything else that is no space.
_WORDS = Regex(r"'s|'t|'re|'ve|'m|'ll|'d|\p{L}+|\p{N}|[^\s\p{L}\p{N}]+")


def load_clip_bpe(folder: Path) -> Tokenizer:
    """Returns the tokenizer of a CLIP's folder: `tokenizer.json`, or else `vocab.json` with `merges.txt`.

    Raises:
        UserError: if there is neither, or it is no tokenizer of CLIP's.
    """
    path = folder / TOKENIZER_FILE
    if path.exists():
        tokenizer = load_bpe(folder)
    elif (folder / VOCABULARY_FILE).exists() and (folder / MERGES_FILE).exists():
        path = folder / VOCABULARY_FILE
        tokenizer = _tokenizer_from_vocabulary(path, folder / MERGES_FILE)
    else:
        raise UserError(f"{folder}: no tokenizer; put {TOKENIZER_FILE}, or {VOCABULARY_FILE} and {MERGES_FILE}, there")
    for special in (START, END):
        if tokenizer.token_to_id(special) is None:
            raise UserError(f"{path}: has no token {special!r}, so it is not a tokenizer of CLIP's")
    # Cutting and filling are ours, whatever the file was last used for.
    tokenizer.no_truncation()
    tokenizer.no_padding()
    return tokenizer


def _tokenizer_from_vocabulary(vocabulary_path: Path, merges_path: Path) -> Tokenizer:
    """Returns CLIP's tokenizer built from its two older files."""
    vocabulary = _read_vocabulary(vocabulary_path)
    merges = _read_merges(merges_path)
    try:
        bpe = models.BPE(vocab=vocabulary, merges=merges, unk_token=END, end_of_word_suffix=END_OF_WORD)
    except Exception as error:  # noqa: BLE001 - the library raises nothing narrower for content it cannot use
        raise UserError(f"{merges_path}: does not fit {vocabulary_path.name} ({str(error).splitlines()[0]})") from None
    tokenizer = Tokenizer(bpe)
    tokenizer.normalizer = normalizers.Sequence(
        [normalizers.NFC(), normalizers.Replace(Regex(r"\s+"), " "), normalizers.Lowercase()]
    )
    tokenizer.pre_tokenizer = pre_tokenizers.Sequence(
        [
            pre_tokenizers.Split(_WORDS, behavior="removed", invert=True),
            pre_tokenizers.ByteLevel(add_prefix_space=False, use_regex=False),
        ]
    )
    tokenizer.decoder = decoders.ByteLevel()
    specials = [special for special in (START, END) if special in vocabulary]
    tokenizer.add_special_tokens([AddedToken(special, normalized=False, special=True) for special in specials])
    return tokenizer


def _read_vocabulary(path: Path) -> dict[str, int]:
    try:
        vocabulary = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(f"{path}: not a JSON file ({error})") from None
    if not isinstance(vocabulary, dict) or sorted(map(repr, vocabulary.values())) != sorted(
        map(repr, range(len(vocabulary)))
    ):
        raise UserError(f"{path}: not a vocabulary; each token needs its own number, from 0 without gaps")
    return vocabulary


def _read_merges(path: Path) -> list[tuple[str, str]]:
    """Returns the pairs of a merges file; its first line may tell a version."""
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: not a text file in UTF-8 ({error})") from None
    merges = []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or (number == 1 and line.startswith("#version")):
            continue
        pair = line.split()
        if len(pair) != 2:
            raise UserError(f"{path}:{number}: expected two pieces with a space between")
        merges.append((pair[0], pair[1]))
    return merges


def clip_tokens(tokenizer: Tokenizer, captions: Sequence[str], *, max_length: int) -> Int[np.ndarray, "B S"]:
    """Returns start, caption and end, filled with further ends to `max_length`.

    A longer caption loses its last tokens, never the end, as in `clip.tokenize(…, truncate=True)`. Unlike there,
    HTML entities and broken encodings are read as they stand: no caption of the field's data sets has any.
    """
    start, end = tokenizer.token_to_id(START), tokenizer.token_to_id(END)
    assert start is not None and end is not None, "not a tokenizer of CLIP's"
    tokens = np.full((len(captions), max_length), end, np.int32)
    tokens[:, 0] = start
    for row, encoding in enumerate(tokenizer.encode_batch(list(captions), add_special_tokens=False)):
        ids = encoding.ids[: max_length - 2]
        tokens[row, 1 : 1 + len(ids)] = ids
    return tokens
