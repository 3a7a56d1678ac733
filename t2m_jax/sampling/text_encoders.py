"""The text encoder of a model: a network that was trained with its generator, a pretrained encoder, or both."""

import functools
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from tokenizers import Tokenizer
from tqdm import tqdm

from t2m_jax.checkpoints.bundle import Bundle
from t2m_jax.checkpoints.clip import TrainedClip
from t2m_jax.checkpoints.sentence import TrainedSentenceEncoder
from t2m_jax.checkpoints.text_encoder import (
    PretrainedEncoder,
    SentenceReference,
    SentenceStatesConfig,
    is_packaged,
    load_pretrained,
)
from t2m_jax.errors import UserError
from t2m_jax.models.caption_encoder import CaptionEncoder, CaptionEncoderConfig, StateEncoder, StateEncoderConfig
from t2m_jax.models.clip_text import ClipText
from t2m_jax.models.rows import apply_compiled
from t2m_jax.models.sentence_encoder import SentenceEncoder
from t2m_jax.sampling.batches import fill_up, padded_batch_size
from t2m_jax.text.bpe import clip_tokens, read_part, tokenize_captions
from t2m_jax.text.embedding_cache import EmbeddingCache
from t2m_jax.text.encoder import TextEncoder

MAX_BATCH = 64
"""Captions that a pretrained encoder embeds together."""


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
        inputs = (jnp.asarray(tokens), jnp.asarray(mask))
        return _finite(apply_compiled(self._variables, *inputs, module=CaptionEncoder(self._config), train=False))

    def read_part(self, caption: str) -> str:
        """Returns the caption up to its last subword that is read."""
        return read_part(self._bpe, caption, max_length=self._config.max_length)


class SentenceStates:
    """The token states of captions, by a sentence encoder that is not trained."""

    def __init__(self, reference: SentenceReference, *, state_dim: int | None = None):
        """Loads the encoder, or if it is part of the package, waits until it is needed.

        Raises:
            UserError: It cannot be found, has changed, or has states of another width.
        """
        self._reference = reference
        self._state_dim = state_dim
        if not is_packaged(reference):
            self.encoder  # noqa: B018 - now, so that a missing encoder shows before any work

    @functools.cached_property
    def encoder(self) -> TrainedSentenceEncoder:
        """The sentence encoder, with its weights on the default device."""
        encoder = load_pretrained(self._reference, text_dim=self._state_dim)
        assert isinstance(encoder, TrainedSentenceEncoder)
        return encoder._replace(variables=jax.device_put(encoder.variables))

    @property
    def fingerprint(self) -> str:
        """Identifies the encoder."""
        return self.encoder.fingerprint

    def read_batch(self, captions: Sequence[str]) -> tuple[Float[Array, "B S C"], Bool[Array, "B S"]]:
        """Returns the states of some captions, and where they are, for a number of captions that is a power of two."""
        tokens, mask = _sentence_tokens(self.encoder, fill_up(captions))
        # States are stored and compared across machines, so no device may shorten the products.
        with jax.default_matmul_precision("highest"):
            module = SentenceEncoder(self.encoder.config)
            states = apply_compiled(self.encoder.variables, tokens, mask, module=module, method="states")
        return states.astype(jnp.float16), mask  # as they are stored for training

    def read_all(self, captions: Sequence[str]) -> Iterator[tuple[str, Float[np.ndarray, "S C"]]]:
        """Yields each caption with the states of its tokens, short captions first."""
        ordered = sorted(captions, key=len)
        with tqdm(total=len(ordered), desc="reading captions", unit="caption", disable=None) as progress:
            for first in range(0, len(ordered), MAX_BATCH):
                batch = ordered[first : first + MAX_BATCH]
                states, mask = jax.device_get(self.read_batch(batch))
                for caption, own, used in zip(batch, states, mask, strict=False):
                    yield caption, own[used]
                progress.update(len(batch))


class StatesTextEncoder:
    """A `TextEncoder` made of a pretrained sentence encoder and a trained network that reads its token states."""

    def __init__(self, config: StateEncoderConfig, variables: Any, states: SentenceStates):
        """Keeps the three parts; `variables` are those of `StateEncoder`."""
        self._config = config
        self._variables = variables
        self._states = states

    @property
    def fingerprint(self) -> str:
        """Identifies the pretrained encoder."""
        return self._states.fingerprint

    def __call__(self, captions: Sequence[str]) -> Float[Array, "B E"]:
        """Returns one embedding per caption; long captions are cut."""
        if not captions:
            return jnp.zeros((0, self._config.text_dim))
        states, mask = self._states.read_batch(captions)
        length = self._config.max_length
        inputs = (states[:, :length].astype(jnp.float32), mask[:, :length])
        found = apply_compiled(self._variables, *inputs, module=StateEncoder(self._config), train=False)
        return _finite(found[: len(captions)])

    def sentence_embeddings(self, sentences: Sequence[str]) -> Float[np.ndarray, "B C"]:
        """Returns the mean of the token states of each sentence, which says what it means, not only what is learned."""
        means = []
        for first in range(0, len(sentences), MAX_BATCH):
            batch = sentences[first : first + MAX_BATCH]
            states, mask = jax.device_get(self._states.read_batch(batch))
            # States that are not used are zero.
            means.append((states.sum(axis=1) / np.maximum(mask.sum(axis=1, keepdims=True), 1))[: len(batch)])
        return np.concatenate(means)

    def read_part(self, caption: str) -> str:
        """Returns the caption up to its last subword that is read, besides the marks that the encoder adds."""
        encoder = self._states.encoder
        length = min(encoder.config.max_length, self._config.max_length)
        marks = encoder.tokenizer.num_special_tokens_to_add(False)
        return read_part(encoder.tokenizer, caption, max_length=max(length - marks, 1))


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
                tokens = jnp.asarray(clip_tokens(encoder.tokenizer, filled, max_length=encoder.config.max_length))
                embeddings = apply_compiled(encoder.variables, tokens, module=ClipText(encoder.config))
            else:
                inputs = _sentence_tokens(encoder, filled)
                embeddings = apply_compiled(encoder.variables, *inputs, module=SentenceEncoder(encoder.config))
        return np.asarray(_finite(embeddings))[: len(captions)]


def _finite(embeddings: Float[Array, "B E"]) -> Float[Array, "B E"]:
    """Returns embeddings. From others, every motion would be the same one, without a word.

    Raises:
        UserError: A number is not finite.
    """
    if not np.isfinite(np.asarray(embeddings)).all():
        raise UserError("the text encoder makes numbers that are not finite; its files are damaged or of another model")
    return embeddings


def _sentence_tokens(
    encoder: TrainedSentenceEncoder, captions: Sequence[str]
) -> tuple[Int[Array, "B S"], Bool[Array, "B S"]]:
    tokens, mask = tokenize_captions(encoder.tokenizer, captions, max_length=encoder.config.max_length)
    width = padded_batch_size(int(mask.sum(axis=1).max()))  # few different widths, so that few programs are compiled
    return jnp.asarray(tokens[:, :width]), jnp.asarray(mask[:, :width])


def make_text_encoder(bundle: Bundle, *, states: SentenceStates | None = None) -> TextEncoder:
    """Returns the text encoder of a model.

    Args:
        bundle: The model.
        states: Its sentence encoder, if it reads token states and the encoder is loaded already.

    Raises:
        UserError: It is a pretrained encoder that cannot be found, has changed, or has another width.
    """
    config = bundle.config.text_encoder
    if isinstance(config, SentenceStatesConfig):
        states = states or SentenceStates(config.encoder, state_dim=config.network.state_dim)
        return StatesTextEncoder(config.network, jax.device_put(bundle.variables["text_encoder"]), states)
    if bundle.bpe is not None:
        return CaptionTextEncoder(config, jax.device_put(bundle.variables["text_encoder"]), bundle.bpe)
    return PretrainedTextEncoder(load_pretrained(config, text_dim=bundle.config.generator.text_dim))
