"""The text encoder of a model: the caption encoder that was trained with its generator, or CLIP."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from tokenizers import Tokenizer

from t2m_jax.checkpoints.bundle import Bundle
from t2m_jax.checkpoints.clip import TrainedClip, load_clip
from t2m_jax.models.caption_encoder import CaptionEncoder, CaptionEncoderConfig
from t2m_jax.models.clip_text import ClipText, ClipTextConfig
from t2m_jax.sampling.batches import padded_batch_size
from t2m_jax.text.bpe import read_part, tokenize_captions
from t2m_jax.text.clip_bpe import clip_tokens
from t2m_jax.text.embedding_cache import EmbeddingCache
from t2m_jax.text.encoder import TextEncoder

MAX_BATCH = 64
"""Captions that CLIP embeds together."""


@functools.partial(jax.jit, static_argnames="config")
def encode_captions(
    variables: Any, caption_tokens: Int[Array, "B S"], caption_mask: Bool[Array, "B S"], *, config: CaptionEncoderConfig
) -> Float[Array, "B E"]:
    """Returns the text embeddings of captions, given as tokens of the caption encoder."""
    return CaptionEncoder(config).apply(variables, caption_tokens, caption_mask, train=False)


class CaptionTextEncoder:
    """A `TextEncoder` made of a subword tokenizer and a trained caption encoder."""

    def __init__(self, config: CaptionEncoderConfig, variables: Any, bpe: Tokenizer):
        """Keeps the three parts; `variables` are those of `CaptionEncoder`."""
        self._config = config
        self._variables = variables
        self._bpe = bpe

    def __call__(self, captions: Sequence[str]) -> Float[Array, "B E"]:
        """Returns one embedding per caption; long captions are cut."""
        tokens, mask = tokenize_captions(self._bpe, captions, max_length=self._config.max_length)
        return encode_captions(self._variables, jnp.asarray(tokens), jnp.asarray(mask), config=self._config)

    def read_part(self, caption: str) -> str:
        """Returns the caption up to its last subword that is read."""
        return read_part(self._bpe, caption, max_length=self._config.max_length)


@functools.partial(jax.jit, static_argnames="config")
def encode_clip_tokens(
    variables: Any, caption_tokens: Int[Array, "B S"], *, config: ClipTextConfig
) -> Float[Array, "B E"]:
    """Returns the text embeddings of captions, given as tokens of CLIP."""
    return ClipText(config).apply(variables, caption_tokens)


class ClipTextEncoder:
    """A `TextEncoder` made of a trained CLIP, with an optional cache on disk."""

    def __init__(self, clip: TrainedClip, *, cache: EmbeddingCache | None = None):
        """Puts the weights on the default device."""
        self._config, self._tokenizer, self.fingerprint = clip.config, clip.tokenizer, clip.fingerprint
        self._variables = jax.device_put(clip.variables)
        self._cache = cache

    def __call__(self, captions: Sequence[str]) -> Float[Array, "B E"]:
        """Returns one embedding per caption; captions that are too long for CLIP are cut."""
        wanted = list(dict.fromkeys(captions))
        known = self._cache.load(self.fingerprint, wanted) if self._cache else {}
        missing = [caption for caption in wanted if caption not in known]
        for first in range(0, len(missing), MAX_BATCH):
            batch = missing[first : first + MAX_BATCH]
            embedded = dict(zip(batch, self._embed(batch), strict=True))
            known |= embedded
            if self._cache:  # after each batch, so that an interruption loses little
                self._cache.save(self.fingerprint, embedded)
        embeddings = np.zeros((len(captions), self._config.text_dim), np.float32)
        for row, caption in enumerate(captions):
            embeddings[row] = known[caption]
        return jnp.asarray(embeddings)

    def read_part(self, caption: str) -> str:
        """Returns the caption up to its last subword that is read, between CLIP's marks of start and end."""
        return read_part(self._tokenizer, caption, max_length=self._config.max_length - 2)

    def _embed(self, captions: Sequence[str]) -> Float[np.ndarray, "B E"]:
        tokens = clip_tokens(self._tokenizer, captions, max_length=self._config.max_length)
        filling = np.repeat(tokens[:1], padded_batch_size(len(captions)) - len(captions), axis=0)
        # Embeddings are cached and compared across machines, so no device may shorten the products.
        with jax.default_matmul_precision("highest"):
            filled = jnp.asarray(np.concatenate([tokens, filling]))
            embeddings = encode_clip_tokens(self._variables, filled, config=self._config)
        return np.asarray(embeddings)[: len(captions)]


def make_text_encoder(bundle: Bundle) -> TextEncoder:
    """Returns the text encoder of a model.

    Raises:
        UserError: It is CLIP, and CLIP cannot be found or has another width than the generator reads.
    """
    config = bundle.config.text_encoder
    if bundle.bpe is not None:
        return CaptionTextEncoder(config, jax.device_put(bundle.variables["text_encoder"]), bundle.bpe)
    return ClipTextEncoder(load_clip(config.name, text_dim=bundle.config.generator.text_dim))
