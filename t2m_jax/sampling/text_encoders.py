"""The text encoder of a model: the caption encoder that was trained with its generator, or a pretrained encoder."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from tokenizers import Tokenizer

from t2m_jax.checkpoints.bundle import Bundle
from t2m_jax.checkpoints.clip import TrainedClip
from t2m_jax.checkpoints.sentence import TrainedSentenceEncoder
from t2m_jax.checkpoints.text_encoder import PretrainedEncoder, load_pretrained
from t2m_jax.models.caption_encoder import CaptionEncoder, CaptionEncoderConfig
from t2m_jax.models.clip_text import ClipText, ClipTextConfig
from t2m_jax.models.sentence_encoder import SentenceEncoder, SentenceEncoderConfig
from t2m_jax.sampling.batches import fill_up, padded_batch_size
from t2m_jax.text.bpe import read_part, tokenize_captions
from t2m_jax.text.clip_bpe import clip_tokens
from t2m_jax.text.embedding_cache import EmbeddingCache
from t2m_jax.text.encoder import TextEncoder

MAX_BATCH = 64
"""Captions that a pretrained encoder embeds together."""


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


@functools.partial(jax.jit, static_argnames="config")
def encode_sentence_tokens(
    variables: Any,
    caption_tokens: Int[Array, "B S"],
    caption_mask: Bool[Array, "B S"],
    *,
    config: SentenceEncoderConfig,
) -> Float[Array, "B E"]:
    """Returns the text embeddings of captions, given as tokens of a sentence encoder."""
    return SentenceEncoder(config).apply(variables, caption_tokens, caption_mask)


class PretrainedTextEncoder:
    """A `TextEncoder` that was not trained with the generator, with an optional cache on disk."""

    def __init__(self, encoder: PretrainedEncoder, *, cache: EmbeddingCache | None = None):
        """Puts the weights on the default device."""
        self.fingerprint = encoder.fingerprint
        self._encoder = encoder._replace(variables=jax.device_put(encoder.variables))
        self._cache = cache

    def __call__(self, captions: Sequence[str]) -> Float[Array, "B E"]:
        """Returns one embedding per caption; captions that are too long for the encoder are cut."""
        # Each once: the samples of a batch often have one caption.
        wanted = list(dict.fromkeys(captions))
        known = self._cache.load(self.fingerprint, wanted) if self._cache else {}
        # Captions of similar lengths need little padding.
        missing = sorted((caption for caption in wanted if caption not in known), key=len)
        for first in range(0, len(missing), MAX_BATCH):
            batch = missing[first : first + MAX_BATCH]
            embedded = dict(zip(batch, self._embed(batch), strict=True))
            known |= embedded
            if self._cache:  # after each batch, so that an interruption loses little
                self._cache.save(self.fingerprint, embedded)
        embeddings = np.zeros((len(captions), self._encoder.config.text_dim), np.float32)
        for row, caption in enumerate(captions):
            embeddings[row] = known[caption]
        return jnp.asarray(embeddings)

    def read_part(self, caption: str) -> str:
        """Returns the caption up to its last subword that is read, besides the marks that an encoder adds."""
        encoder = self._encoder
        # CLIP adds its marks outside the tokenizer, so that does not count them.
        marks = 2 if isinstance(encoder, TrainedClip) else encoder.tokenizer.num_special_tokens_to_add(False)
        return read_part(encoder.tokenizer, caption, max_length=encoder.config.max_length - marks)

    def _embed(self, captions: Sequence[str]) -> Float[np.ndarray, "B E"]:
        filled = fill_up(captions)
        encoder = self._encoder
        # Embeddings are cached and compared across machines, so no device may shorten the products.
        with jax.default_matmul_precision("highest"):
            if isinstance(encoder, TrainedClip):
                embeddings = _embed_with_clip(encoder, filled)
            else:
                embeddings = _embed_sentences(encoder, filled)
        return np.asarray(embeddings)[: len(captions)]


def _embed_with_clip(clip: TrainedClip, captions: Sequence[str]) -> Float[Array, "B E"]:
    tokens = clip_tokens(clip.tokenizer, captions, max_length=clip.config.max_length)
    return encode_clip_tokens(clip.variables, jnp.asarray(tokens), config=clip.config)


def _embed_sentences(encoder: TrainedSentenceEncoder, captions: Sequence[str]) -> Float[Array, "B E"]:
    tokens, mask = tokenize_captions(encoder.tokenizer, captions, max_length=encoder.config.max_length)
    width = padded_batch_size(int(mask.sum(axis=1).max()))  # few different widths, so that few programs are compiled
    tokens = jnp.asarray(tokens[:, :width])
    mask = jnp.asarray(mask[:, :width])
    return encode_sentence_tokens(encoder.variables, tokens, mask, config=encoder.config)


def make_text_encoder(bundle: Bundle) -> TextEncoder:
    """Returns the text encoder of a model.

    Raises:
        UserError: It is a pretrained encoder that cannot be found, has changed, or has another width.
    """
    config = bundle.config.text_encoder
    if bundle.bpe is not None:
        return CaptionTextEncoder(config, jax.device_put(bundle.variables["text_encoder"]), bundle.bpe)
    return PretrainedTextEncoder(load_pretrained(config, text_dim=bundle.config.generator.text_dim))
