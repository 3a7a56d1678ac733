"""The order of training data, and one random key per row of a batch.

Everything is a pure function of a key, the step and the number of a row in the global batch. So each device or process
computes its own rows, and their number changes nothing.
"""

from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key, UInt32

AnyArray: TypeAlias = Array | np.ndarray
"""An array of a bank: on the host, and on devices during training."""
Step: TypeAlias = Int[Array, ""] | int
"""Number of a training step, counted from 0 over the whole run."""
ROUNDS = 8
"""Rounds of the Feistel network. Four make a permutation that looks random; twice as many are a margin."""


def _mix(values: UInt32[Array, " B"], key: UInt32[Array, ""]) -> UInt32[Array, " B"]:
    """Returns a hash of each value (the finalizer of MurmurHash3, with its constants)."""
    values = values ^ key
    values = (values ^ (values >> 16)) * jnp.uint32(0x85EBCA6B)
    values = (values ^ (values >> 13)) * jnp.uint32(0xC2B2AE35)
    return values ^ (values >> 16)


def shuffled(positions: Int[Array, " B"], key: Key[Array, ""], *, size: int) -> Int[Array, " B"]:
    """Returns the items at some positions of a random order of the items 0 to `size` - 1.

    The order is not made: a Feistel network permutes a power of four, and results that are too large are permuted again
    (cycle walking; Black and Rogaway, 2002). A shuffle of all items would be a sort at each step.

    Args:
        positions: From 0 to `size` - 1.
        key: Of the order.
        size: Number of items.
    """
    # The halves are equally long, so the network permutes a power of four. More than a quarter of it are items, so a
    # walk has fewer than four steps on average.
    half = max((size - 1).bit_length() + 1, 2) // 2
    # A number has two halves of `half` bits; `low` is the mask of the right one.
    low = jnp.uint32((1 << half) - 1)
    round_keys = jax.random.bits(key, (ROUNDS,), jnp.uint32)

    def permute(values: UInt32[Array, " B"]) -> UInt32[Array, " B"]:
        left = values >> half
        right = values & low
        for number in range(ROUNDS):
            left, right = right, left ^ (_mix(right, round_keys[number]) & low)
        return (left << half) | right

    def walk(values: UInt32[Array, " B"]) -> UInt32[Array, " B"]:
        return jnp.where(values < size, values, permute(values))

    first = permute(positions.astype(jnp.uint32))
    return jax.lax.while_loop(lambda values: jnp.any(values >= size), walk, first).astype(jnp.int32)


def batch_items(
    key: Key[Array, ""], step: Step, rows: Int[Array, " B"], *, num_items: int, batch_size: int
) -> Int[Array, " B"]:
    """Returns the items of some rows of the batch of a training step (counted from 0 over the whole run).

    An epoch has `num_items // batch_size` steps, in each of which every item comes at most once; the items at the end
    of the order that do not fill a batch are not used in this epoch. A data set smaller than one batch is repeated in
    the batch.

    Args:
        key: Key of the run's data order. It is not consumed: give the same key at every step.
        step: Number of the step.
        rows: Numbers of rows in the global batch, see `devices.own_rows`.
        num_items: Items in the data set.
        batch_size: Rows of the global batch.
    """
    steps_per_epoch = max(num_items // batch_size, 1)
    epoch = step // steps_per_epoch
    first = (step % steps_per_epoch) * batch_size
    # The remainder differs only if the data are smaller than a batch.
    return shuffled((first + rows) % num_items, jax.random.fold_in(key, epoch), size=num_items)


def shared_items(
    key: Key[Array, ""], step: Step, rows: Int[Array, " B"], shares: Float[AnyArray, " M"], *, batch_size: int
) -> Int[Array, " B"]:
    """Returns the items of some rows of a step, each as often as its share says (see `batch_items`).

    An epoch has as many draws as there are items. An item whose share is 2.3 of them comes two or three times.

    Args:
        key: Key of the run's data order. It is not consumed.
        step: Number of the step.
        rows: Numbers of rows in the global batch.
        shares: Of the items up to each one; the last is 1.
        batch_size: Rows of the global batch.
    """
    num_items = shares.shape[0]
    order_key, start_key = jax.random.split(key)
    places = batch_items(order_key, step, rows, num_items=num_items, batch_size=batch_size)
    # Systematic sampling: points at equal distances, from a start that is drawn for each epoch.
    start = jax.random.uniform(jax.random.fold_in(start_key, step // max(num_items // batch_size, 1)))
    points = (places + start) / num_items
    return jnp.minimum(jnp.searchsorted(shares, points, side="right"), num_items - 1).astype(jnp.int32)


def row_keys(key: Key[Array, ""], step: Step, rows: Int[Array, " B"]) -> Key[Array, " B"]:
    """Returns the key of each row of the batch of a step, for draws that belong to that row alone."""
    return jax.vmap(jax.random.fold_in, (None, 0))(jax.random.fold_in(key, step), rows)


def draw_below(keys: Key[Array, " B"], limits: Int[Array, " B"] | int) -> Int[Array, " B"]:
    """Returns a whole number from 0 to below the limit of each row; keys are consumed."""
    # One draw per key: a draw of the whole batch would depend on how many rows a device has.
    limits = jnp.broadcast_to(jnp.asarray(limits), keys.shape)
    return jax.vmap(lambda key, limit: jax.random.randint(key, (), 0, limit))(keys, limits)


def split_each(keys: Key[Array, " B"], count: int) -> tuple[Key[Array, " B"], ...]:
    """Returns `count` keys for each row, as one array per use; `keys` are consumed."""
    return tuple(jnp.moveaxis(jax.vmap(lambda key: jax.random.split(key, count))(keys), 1, 0))
