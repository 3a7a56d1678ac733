"""Captions as models read them."""

from t2m_jax.text.bpe import CaptionTokens, load_bpe, save_bpe, tokenize_captions, train_bpe
from t2m_jax.text.clip_bpe import clip_tokens, load_clip_bpe
from t2m_jax.text.embedding_cache import EmbeddingCache
from t2m_jax.text.encoder import TextEncoder
from t2m_jax.text.prompts import check_prompt

__all__ = [
    "CaptionTokens",
    "EmbeddingCache",
    "TextEncoder",
    "check_prompt",
    "clip_tokens",
    "load_bpe",
    "load_clip_bpe",
    "save_bpe",
    "tokenize_captions",
    "train_bpe",
]
