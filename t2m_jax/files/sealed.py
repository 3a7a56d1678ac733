"""Texts that end with their own checksum, so that a text that is written again needs no manifest."""

import hashlib
from pathlib import Path

from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_text
from t2m_jax.files.writing import save_text

_SEAL = "# SHA-256 of the lines above: "
"""Begins the last line, which is a comment in YAML."""


def save_sealed(path: Path, text: str) -> None:
    """Writes lines of text and their checksum."""
    save_text(path, f"{text}{_seal(text)}")


def load_sealed(path: Path) -> str:
    """Returns a text without its checksum.

    Raises:
        UserError: It is missing, or has changed since it was written.
    """
    found = load_text(path)
    text, _, _ = found.rpartition(_SEAL)
    if found != f"{text}{_seal(text)}":
        raise UserError(f"{path}: has changed since it was written, or is damaged; put the old file back")
    return text


def _seal(text: str) -> str:
    return f"{_SEAL}{hashlib.sha256(text.encode()).hexdigest()}\n"
