"""CLIP's tokens of captions: its byte-level BPE, by the `tokenizers` library."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int
from tokenizers import AddedToken, Regex, Tokenizer, decoders, models, normalizers, pre_tokenizers

from t2m_jax.errors import UserError
from t2m_jax.files.reading import first_line, load_json, load_text
from t2m_jax.text.bpe import TOKENIZER_FILE, load_bpe

START = "<|startoftext|>"
END = "<|endoftext|>"
END_OF_WORD = "</w>"
VOCABULARY_FILE = "vocab.json"
MERGES_FILE = "merges.txt"

# English endings, runs of letters, single digits, and runs of anything else except spaces.
_WORDS = Regex(r"'s|'t|'re|'ve|'m|'ll|'d|\p{L}+|\p{N}|[^\s\p{L}\p{N}]+")


def load_clip_bpe(folder: Path) -> Tokenizer:
    """Returns the tokenizer of a CLIP's folder: `tokenizer.json`, or else `vocab.json` with `merges.txt`.

    Raises:
        UserError: The folder has neither, or the tokenizer is not CLIP's.
    """
    path = folder / TOKENIZER_FILE
    if path.exists():
        tokenizer = load_bpe(folder)
    elif (folder / VOCABULARY_FILE).exists() and (folder / MERGES_FILE).exists():
        path = folder / VOCABULARY_FILE
        tokenizer = _bpe_from_older_files(path, folder / MERGES_FILE)
    else:
        raise UserError(f"{folder}: has no tokenizer; add {TOKENIZER_FILE}, or {VOCABULARY_FILE} and {MERGES_FILE}")
    for special in (START, END):
        if tokenizer.token_to_id(special) is None:
            raise UserError(f"{path}: has no token {special!r}; give the tokenizer of a CLIP")
    # `clip_tokens` cuts and pads. The file may still contain the settings of its last use.
    tokenizer.no_truncation()
    tokenizer.no_padding()
    return tokenizer


def _bpe_from_older_files(vocabulary_path: Path, merges_path: Path) -> Tokenizer:
    """Returns the tokenizer of a list of tokens and a list of merges."""
    vocabulary = load_json(vocabulary_path)
    numbers = sorted(map(repr, vocabulary.values())) if isinstance(vocabulary, dict) else None
    if numbers != sorted(map(repr, range(len(vocabulary)))):
        raise UserError(f"{vocabulary_path}: not a vocabulary; each token needs its own number, from 0 without gaps")
    merges = []
    for number, line in enumerate(load_text(merges_path).split("\n"), start=1):
        if not line.strip() or (number == 1 and line.startswith("#version")):
            continue
        pair = line.split()
        if len(pair) != 2:
            raise UserError(f"{merges_path}:{number}: expected two tokens with a space between them")
        merges.append((pair[0], pair[1]))
    try:
        bpe = models.BPE(vocab=vocabulary, merges=merges, unk_token=END, end_of_word_suffix=END_OF_WORD)
    except Exception as error:  # noqa: BLE001 - the library raises nothing narrower for content it cannot use
        raise UserError(f"{merges_path}: does not fit {vocabulary_path.name} ({first_line(error)})") from None
    tokenizer = Tokenizer(bpe)
    spaces = normalizers.Replace(Regex(r"\s+"), " ")
    tokenizer.normalizer = normalizers.Sequence([normalizers.NFC(), spaces, normalizers.Lowercase()])
    words = pre_tokenizers.Split(_WORDS, behavior="removed", invert=True)
    letters = pre_tokenizers.ByteLevel(add_prefix_space=False, use_regex=False)
    tokenizer.pre_tokenizer = pre_tokenizers.Sequence([words, letters])
    tokenizer.decoder = decoders.ByteLevel()
    specials = [special for special in (START, END) if special in vocabulary]
    tokenizer.add_special_tokens([AddedToken(special, normalized=False, special=True) for special in specials])
    return tokenizer


def clip_tokens(tokenizer: Tokenizer, captions: Sequence[str], *, max_length: int) -> Int[np.ndarray, "B S"]:
    """Returns a start token, the caption, and end tokens up to `max_length`.

    A longer caption loses its last tokens, but never the end token, as in `clip.tokenize(…, truncate=True)`. That
    function also repairs HTML entities and broken encodings. This one does not: the captions of the published data
    sets have none.
    """
    start, end = map(tokenizer.token_to_id, (START, END))
    assert start is not None and end is not None, "the tokenizer is not CLIP's"
    tokens = np.full((len(captions), max_length), end, np.int32)
    tokens[:, 0] = start
    for number, encoding in enumerate(tokenizer.encode_batch(list(captions), add_special_tokens=False)):
        # Two places are for the start and the end.
        ids = encoding.ids[: max_length - 2]
        tokens[number, 1 : 1 + len(ids)] = ids
    return tokens
