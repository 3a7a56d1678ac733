"""Codes and captions of a data set on the device: what a generator is trained on."""

from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from t2m_jax.data.banks.order import AnyArray, Step, batch_items, draw_below, row_keys, shared_items, split_each
from t2m_jax.devices import own_rows, split_rows
from t2m_jax.text.bpe import CaptionTokens
from t2m_jax.text.caption_states import CaptionStates, StateTable, captions_at

Captions: TypeAlias = CaptionTokens | CaptionStates | StateTable | Float[Array, "B E"]
"""Captions as tokens or token states for a network that is trained, or as embeddings of one that is not. The states of
all captions are a table, those of a batch are not."""


class CodeBank(NamedTuple):
    """The codes of every motion from S starting offsets, and all captions in one table."""

    codes: Int[AnyArray, "M S N R"]
    code_lengths: Int[AnyArray, "M S"]
    captions: Captions
    """One row per caption."""
    first_caption: Int[AnyArray, " M"]
    num_captions: Int[AnyArray, " M"]
    shares: Float[AnyArray, " M"] | None = None
    """Of the motions up to each one in the draws, from above 0 to 1; None draws every motion equally often."""


class CodeBatch(NamedTuple):
    """Motions as codes, each with one of its captions."""

    codes: Int[Array, "B N R"]
    code_lengths: Int[Array, " B"]
    captions: Captions


def crop_codes(
    codes: Int[Array, "B N R"], code_lengths: Int[Array, " B"], keys: Key[Array, " B"], *, max_codes: int
) -> tuple[Int[Array, "B M R"], Int[Array, " B"]]:
    """Returns at most `max_codes` rows of each motion, from a uniformly drawn start; `keys` are consumed."""
    start = draw_below(keys, jnp.maximum(code_lengths - max_codes, 0) + 1)
    # `dynamic_slice` moves a start that is too near to the end, and with it the codes.
    padded = jnp.pad(codes, ((0, 0), (0, max_codes), (0, 0)))
    cropped = jax.vmap(lambda rows, first: jax.lax.dynamic_slice_in_dim(rows, first, max_codes))(padded, start)
    return cropped, jnp.minimum(code_lengths, max_codes)


def code_batch_at(bank: CodeBank, key: Key[Array, ""], step: Step, *, batch_size: int, max_codes: int) -> CodeBatch:
    """Returns the batch of a training step: a pure function of the run's data key and the step.

    Every motion comes once per epoch, or as often as its share says, with a uniformly drawn offset and caption.
    """
    bank = jax.tree.map(jnp.asarray, bank)
    order_key, draw_key = jax.random.split(key)
    rows = own_rows(batch_size)
    if bank.shares is None:
        motions = batch_items(order_key, step, rows, num_items=bank.codes.shape[0], batch_size=batch_size)
    else:
        motions = shared_items(order_key, step, rows, bank.shares, batch_size=batch_size)
    offset_keys, caption_keys, crop_keys = split_each(row_keys(draw_key, step, rows), 3)
    # Another first frame divides a motion into other codes, so the generator sees each motion in several ways.
    offsets = draw_below(offset_keys, bank.codes.shape[1])
    caption = bank.first_caption[motions] + draw_below(caption_keys, bank.num_captions[motions])
    lengths = bank.code_lengths[motions, offsets]
    codes, lengths = crop_codes(bank.codes[motions, offsets], lengths, crop_keys, max_codes=max_codes)
    return split_rows(CodeBatch(codes, lengths, captions_at(bank.captions, caption)))
