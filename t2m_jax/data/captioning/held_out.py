"""Test sentences, which no caption may equal. Only fingerprints are here, so that nobody reads them by accident."""

import functools
import hashlib
import importlib.resources

from t2m_jax.data.captioning.lexicon import words_in

FILE = "held_out.txt"


def fingerprint(text: str) -> str:
    """Returns what identifies a sentence; capitals, marks and digits do not count."""
    return hashlib.blake2b(" ".join(words_in(text)).encode(), digest_size=6).hexdigest()


@functools.cache
def held_out_fingerprints() -> frozenset[str]:
    """Returns the fingerprints of all test sentences. `python -m tests.data.captioning.held_out` writes them."""
    return frozenset((importlib.resources.files(__package__) / FILE).read_text(encoding="ascii").split())
