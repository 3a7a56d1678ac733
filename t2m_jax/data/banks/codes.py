"""Codes and captions of a data set on the device: what a generator is trained on."""

from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from t2m_jax.data.banks.motions import batch_clips
from t2m_jax.text.bpe import CaptionTokens

Captions: TypeAlias = CaptionTokens | Float[Array, "B E"]
"""Captions as tokens for a text encoder that is trained, or as embeddings of one that is not."""


class CodeBank(NamedTuple):
    """The codes of every motion from S starting offsets, and all captions in one table."""

    codes: Int[Array, "M S N R"]
    code_lengths: Int[Array, "M S"]
    captions: Captions
    """One row per caption."""
    first_caption: Int[Array, " M"]
    num_captions: Int[Array, " M"]


class CodeBatch(NamedTuple):
    """Motions as codes, each with one of its captions."""

    codes: Int[Array, "B N R"]
    code_lengths: Int[Array, " B"]
    captions: Captions


def crop_codes(
    codes: Int[Array, "B N R"], code_lengths: Int[Array, " B"], key: Key[Array, ""], *, max_codes: int
) -> tuple[Int[Array, "B M R"], Int[Array, " B"]]:
    """Returns at most `max_codes` rows of each motion, from a uniformly drawn start; `key` is consumed."""
    start = jax.random.randint(key, code_lengths.shape, 0, jnp.maximum(code_lengths - max_codes, 0) + 1)
    padded = jnp.pad(codes, ((0, 0), (0, max_codes), (0, 0)))
    cropped = jax.vmap(lambda rows, first: jax.lax.dynamic_slice_in_dim(rows, first, max_codes))(padded, start)
    return cropped, jnp.minimum(code_lengths, max_codes)


def code_batch_at(
    bank: CodeBank, key: Key[Array, ""], step: Int[Array, ""] | int, *, batch_size: int, max_codes: int
) -> CodeBatch:
    """Returns the batch of a training step: a pure function of the run's data key and the step.

    Every motion comes once per epoch, with a uniformly drawn offset and caption.
    """
    order_key, draw_key = jax.random.split(key)
    motions = batch_clips(order_key, step, num_clips=bank.codes.shape[0], batch_size=batch_size)
    offset_key, caption_key, crop_key = jax.random.split(jax.random.fold_in(draw_key, step), 3)
    offsets = jax.random.randint(offset_key, motions.shape, 0, bank.codes.shape[1])
    captions = jax.random.randint(caption_key, motions.shape, 0, bank.num_captions[motions])
    captions = bank.first_caption[motions] + captions
    codes, code_lengths = crop_codes(
        bank.codes[motions, offsets], bank.code_lengths[motions, offsets], crop_key, max_codes=max_codes
    )
    return CodeBatch(codes, code_lengths, jax.tree.map(lambda rows: rows[captions], bank.captions))
