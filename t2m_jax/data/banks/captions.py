"""Motions with their captions on the device: the training data of evaluators.

The motions, captions and crops of a batch are a pure function of the key and the step.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from t2m_jax.data.banks.motions import MotionBank, batch_clips, make_bank, windows_at
from t2m_jax.data.folder import Clip
from t2m_jax.data.texts import Caption
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.text.word_vectors import Vocabulary, WordIds, tokens_from_text

SHORTER_CHANCE = 1 / 3
"""Probability that a crop is one unit shorter than it could be, as in the published loader."""


class CaptionBank(NamedTuple):
    """All motions, and all captions in one array."""

    motions: MotionBank
    captions: WordIds
    """One row per caption."""
    first_caption: Int[Array, " M"]
    num_captions: Int[Array, " M"]


class CaptionBatch(NamedTuple):
    """Crops of motions (normalized, zero after the end), each with one of its captions."""

    motion: Float[Array, "B T D"]
    lengths: Int[Array, " B"]
    captions: WordIds


def caption_tokens(caption: Caption) -> tuple[str, ...]:
    """Returns a caption's `word/TAG` tokens or, if its file has none, the words of its text without tags."""
    return caption.tokens or tokens_from_text(caption.text)


def all_tokens(samples: Iterable[Clip]) -> list[tuple[str, ...]]:
    """Returns the tokens of every caption of some samples."""
    return [caption_tokens(caption) for sample in samples for caption in sample.captions]


def make_caption_bank(samples: Sequence[Clip], normalizer: Normalizer, vocabulary: Vocabulary) -> CaptionBank:
    """Returns motions and captions on the default device.

    Args:
        samples: Samples of text-to-motion (`samples_from_clip`); each has a caption.
        normalizer: Statistics of the evaluator.
        vocabulary: Words of the evaluator.

    Raises:
        UserError: There are no samples, or the statistics have another number of features.
    """
    motions = make_bank(samples, normalizer)
    captions = vocabulary.vectorize_all(all_tokens(samples))
    counts = np.array([len(sample.captions) for sample in samples], np.int32)
    first = np.cumsum(counts, dtype=np.int32) - counts
    return CaptionBank(motions, WordIds(*map(jnp.asarray, captions)), jnp.asarray(first), jnp.asarray(counts))


def used_lengths(lengths: Int[Array, " B"], is_shorter: Bool[Array, " B"], *, unit: int = 4) -> Int[Array, " B"]:
    """Returns the frames of each motion that are used: whole units, one less where `is_shorter`, and at least one."""
    return jnp.maximum(lengths // unit - is_shorter, 1) * unit


def caption_batch_at(
    bank: CaptionBank, key: PRNGKeyArray, step: Int[Array, ""] | int, *, batch_size: int, max_frames: int
) -> CaptionBatch:
    """Returns the batch of a step. Every motion is used once per epoch; caption, length and start are drawn.

    Args:
        bank: Motions of four frames or more.
        key: Key of the run's data order. It is not consumed: give the same key at every step.
        step: Number of the step.
        batch_size: Motions per step.
        max_frames: Frames of the arrays; longer crops are cut.
    """
    order_key, draw_key = jax.random.split(key)
    motions = batch_clips(order_key, step, num_clips=bank.first_caption.shape[0], batch_size=batch_size)
    caption_key, coin_key, start_key = jax.random.split(jax.random.fold_in(draw_key, step), 3)
    caption = bank.first_caption[motions] + jax.random.randint(
        caption_key, motions.shape, 0, bank.num_captions[motions]
    )
    whole = bank.motions.lengths[motions]
    is_shorter = jax.random.bernoulli(coin_key, SHORTER_CHANCE, whole.shape)
    lengths = jnp.minimum(used_lengths(whole, is_shorter), max_frames)
    start = jax.random.randint(start_key, whole.shape, 0, whole - lengths + 1)
    windows = windows_at(bank.motions, bank.motions.starts[motions] + start, lengths, window=max_frames)
    return CaptionBatch(windows.motion, lengths, jax.tree.map(lambda rows: rows[caption], bank.captions))
