"""Captions: checks, tokens, words and embeddings."""

from t2m_jax.text.coverage import PromptWarning
from t2m_jax.text.encoder import TextEncoder

__all__ = ["PromptWarning", "TextEncoder"]
