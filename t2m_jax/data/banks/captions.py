"""Motions with their captions on the device: the training data of evaluators.

The motions, captions and crops of a batch are a pure function of the key and the step.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from t2m_jax.data.banks.motions import Cuts, MotionBank, make_bank, windows_at
from t2m_jax.data.banks.order import AnyArray, Step, batch_items, draw_below, row_keys, split_each
from t2m_jax.data.folder import Clip
from t2m_jax.data.texts import Caption
from t2m_jax.devices import own_rows, split_rows
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.text.word_vectors import Vocabulary, WordIds, tokens_from_text

SHORTER_CHANCE = 1 / 3
"""Probability that a crop is one unit shorter than it could be, as in the published loader."""


class CaptionBank(NamedTuple):
    """All motions, and all captions in one array."""

    motions: MotionBank
    captions: WordIds
    """One row per caption."""
    first_caption: Int[AnyArray, " M"]
    num_captions: Int[AnyArray, " M"]


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
    """Returns motions and captions as NumPy arrays, which training puts on its devices.

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
    # The captions of all motions are end to end, so that motions with few need no padding.
    first = np.cumsum(counts, dtype=np.int32) - counts
    return CaptionBank(motions, WordIds(*captions), first, counts)


def used_lengths(lengths: Int[Array, " B"], is_shorter: Bool[Array, " B"], *, unit: int = 4) -> Int[Array, " B"]:
    """Returns the frames of each motion that are used: whole units, one less where `is_shorter`, and at least one."""
    return jnp.maximum(lengths // unit - is_shorter, 1) * unit


def _draw(
    bank: CaptionBank, key: Key[Array, ""], step: Step, *, batch_size: int, window: int
) -> tuple[Cuts, Int[Array, " B"]]:
    """Returns the cuts and the captions of a step."""
    # NumPy arrays cannot be indexed with traced numbers.
    bank = jax.tree.map(jnp.asarray, bank)
    # The order is the same in all steps of an epoch, so it cannot use the key of a step.
    order_key, draw_key = jax.random.split(key)
    rows = own_rows(batch_size)
    motions = batch_items(order_key, step, rows, num_items=bank.first_caption.shape[0], batch_size=batch_size)
    caption_keys, coin_keys, start_keys = split_each(row_keys(draw_key, step, rows), 3)
    captions = bank.first_caption[motions] + draw_below(caption_keys, bank.num_captions[motions])
    whole = bank.motions.lengths[motions]
    is_shorter = jax.vmap(lambda coin: jax.random.bernoulli(coin, SHORTER_CHANCE))(coin_keys)
    lengths = jnp.minimum(used_lengths(whole, is_shorter), window)
    return Cuts(bank.motions.starts[motions] + draw_below(start_keys, whole - lengths + 1), lengths), captions


def caption_cuts_at(bank: CaptionBank, key: Key[Array, ""], step: Step, *, batch_size: int, window: int) -> Cuts:
    """Returns the cuts of the batch of a step, see `caption_batch_at`. No frames are read."""
    return _draw(bank, key, step, batch_size=batch_size, window=window)[0]


def caption_batch_at(
    bank: CaptionBank, key: Key[Array, ""], step: Step, *, batch_size: int, window: int
) -> CaptionBatch:
    """Returns the batch of a step. Every motion is used once per epoch; caption, length and start are drawn.

    Args:
        bank: Motions of four frames or more.
        key: Key of the run's data order. It is not consumed: give the same key at every step.
        step: Number of the step.
        batch_size: Motions per step.
        window: Frames of the arrays; longer crops are cut.
    """
    cuts, captions = _draw(bank, key, step, batch_size=batch_size, window=window)
    windows = windows_at(bank.motions, step, cuts, window=window)
    words = jax.tree.map(lambda table: table[captions], bank.captions)
    return split_rows(CaptionBatch(windows.motion, cuts.lengths, words))
