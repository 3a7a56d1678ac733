"""Captions as models read them."""

from t2m_jax.text.encoder import TextEncoder
from t2m_jax.text.prompts import check_prompt
from t2m_jax.text.tokenization import CaptionTokens, load_tokenizer, save_tokenizer, tokenize, train_tokenizer

__all__ = [
    "CaptionTokens",
    "TextEncoder",
    "check_prompt",
    "load_tokenizer",
    "save_tokenizer",
    "tokenize",
    "train_tokenizer",
]
