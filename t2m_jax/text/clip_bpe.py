"""CLIP's tokens of captions: its byte-level BPE, by the `tokenizers` library."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int
from tokenizers import Tokenizer

from t2m_jax.errors import UserError
from t2m_jax.text.bpe import TOKENIZER_FILE, load_bpe

START = "<|startoftext|>"
END = "<|endoftext|>"


def load_clip_bpe(folder: Path) -> Tokenizer:
    """Returns the tokenizer of a CLIP's folder.

    Raises:
        UserError: The folder has none, or it is not CLIP's.
    """
    tokenizer = load_bpe(folder)
    for special in (START, END):
        if tokenizer.token_to_id(special) is None:
            raise UserError(f"{folder / TOKENIZER_FILE}: has no token {special!r}; give the tokenizer of a CLIP")
    # `clip_tokens` cuts. The file may still contain the settings of its last use.
    tokenizer.no_truncation()
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
