"""CLIP's text tower as a text encoder."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from t2m_jax.checkpoints.clip import TrainedClip
from t2m_jax.models.clip_text import ClipText, ClipTextConfig
from t2m_jax.text.clip_bpe import clip_tokens
from t2m_jax.text.embedding_cache import EmbeddingCache

MAX_BATCH = 64
"""Captions embedded at a time; more are embedded in turns."""


@functools.partial(jax.jit, static_argnames="config")
def encode_clip_tokens(
    variables: Any, caption_tokens: Int[Array, "B S"], *, config: ClipTextConfig
) -> Float[Array, "B E"]:
    """Returns the text embeddings of tokenized captions."""
    return ClipText(config).apply(variables, caption_tokens)


class ClipTextEncoder:
    """A `TextEncoder` made of a trained CLIP, with an optional cache on disk."""

    def __init__(self, clip: TrainedClip, *, cache: EmbeddingCache | None = None):
        """Puts the weights on the default device."""
        self._config, self._tokenizer, self._fingerprint = clip.config, clip.tokenizer, clip.fingerprint
        self._variables = jax.device_put(clip.variables)
        self._cache = cache

    def __call__(self, captions: Sequence[str]) -> Float[Array, "B E"]:
        """Returns one embedding a caption; what is longer than CLIP reads is cut."""
        wanted = list(dict.fromkeys(captions))
        known = self._cache.load(self._fingerprint, wanted) if self._cache else {}
        missing = [caption for caption in wanted if caption not in known]
        for first in range(0, len(missing), MAX_BATCH):
            batch = missing[first : first + MAX_BATCH]
            embedded = dict(zip(batch, self._embed(batch), strict=True))
            known |= embedded
            if self._cache:  # after each batch, so that work that is interrupted is not lost
                self._cache.save(self._fingerprint, embedded)
        embeddings = np.zeros((len(captions), self._config.text_dim), np.float32)
        for row, caption in enumerate(captions):
            embeddings[row] = known[caption]
        return jnp.asarray(embeddings)

    def _embed(self, captions: Sequence[str]) -> Float[np.ndarray, "B E"]:
        tokens = clip_tokens(self._tokenizer, captions, max_length=self._config.max_length)
        # Sizes are powers of two, so that few programs are compiled; the filling repeats the first caption.
        size = 1 << (len(captions) - 1).bit_length()
        filled = np.concatenate([tokens, np.repeat(tokens[:1], size - len(captions), axis=0)])
        # Embeddings are kept and compared across machines: no shortened products where a device would choose them.
        with jax.default_matmul_precision("highest"):
            embeddings = encode_clip_tokens(self._variables, jnp.asarray(filled), config=self._config)
        return np.asarray(embeddings)[: len(captions)]
