"""Captions: checks, tokens, words and embeddings."""

from t2m_jax.text.bpe import CaptionTokens, load_bpe, save_bpe, tokenize_captions, train_bpe
from t2m_jax.text.clip_bpe import clip_tokens, load_clip_bpe
from t2m_jax.text.embedding_cache import EmbeddingCache
from t2m_jax.text.encoder import TextEncoder
from t2m_jax.text.prompts import check_prompt
from t2m_jax.text.word_vectors import (
    Vocabulary,
    WordIds,
    load_vocabulary,
    load_word_vectors,
    save_vocabulary,
    tokens_from_text,
    vocabulary_from_captions,
)

__all__ = [
    "CaptionTokens",
    "EmbeddingCache",
    "TextEncoder",
    "Vocabulary",
    "WordIds",
    "check_prompt",
    "clip_tokens",
    "load_bpe",
    "load_clip_bpe",
    "load_vocabulary",
    "load_word_vectors",
    "save_bpe",
    "save_vocabulary",
    "tokenize_captions",
    "tokens_from_text",
    "train_bpe",
    "vocabulary_from_captions",
]
