"""The order of training data: every item once per epoch, and rows that do not depend on other rows."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.data.banks.order import batch_items, draw_below, row_keys, shared_items, shuffled, split_each
from tests.jit import assert_jit_equals_eager

order_at = jax.jit(shuffled, static_argnames="size")


def order(key, size):
    """All of a random order."""
    return np.asarray(order_at(jnp.arange(size), key, size=size))


def bits(keys):
    return np.asarray(jax.random.key_data(keys))


@pytest.mark.parametrize("size", [1, 2, 3, 5, 16, 17, 64, 1000])
def test_an_order_has_every_item_once(size):
    np.testing.assert_array_equal(np.sort(order(jax.random.key(size), size)), np.arange(size))


# A power of four, where nothing is permuted again; the largest share that is; a size between.
@pytest.mark.parametrize("size", [16, 17, 50])
def test_every_item_comes_to_every_place_alike(size):
    trials = 4000
    keys = jax.random.split(jax.random.key(0), trials)
    orders = np.asarray(jax.jit(jax.vmap(lambda key: shuffled(jnp.arange(size), key, size=size)))(keys))
    counts = np.stack([np.bincount(places, minlength=size) for places in orders.T])
    # The statistic has a mean of (size - 1)^2 and a variance of twice that.
    statistic = np.sum((counts - trials / size) ** 2) / (trials / size)
    freedom = (size - 1) ** 2
    assert abs(statistic - freedom) < 5 * np.sqrt(2 * freedom)


def test_neighbors_do_not_stay_together():
    """What counts of single places could not see: which item follows which."""
    size, trials = 20, 2000
    keys = jax.random.split(jax.random.key(1), trials)
    orders = np.asarray(jax.jit(jax.vmap(lambda key: shuffled(jnp.arange(size), key, size=size)))(keys))
    steps = np.bincount(np.diff(orders, axis=1).ravel() % size, minlength=size)
    assert steps[0] == 0
    np.testing.assert_allclose(steps[1:] / steps.sum(), 1 / (size - 1), rtol=0.1)


@pytest.mark.slow
def test_other_keys_and_epochs_give_other_orders():
    key = jax.random.key(1)
    orders = {tuple(order(jax.random.key(seed), 50)) for seed in range(20)}
    assert len(orders) == 20
    epochs = [np.asarray(batch_items(key, epoch, jnp.arange(50), num_items=50, batch_size=50)) for epoch in range(20)]
    assert len({tuple(items) for items in epochs}) == 20
    np.testing.assert_array_equal(epochs[2], order(jax.random.fold_in(key, 2), 50))


def test_steps_walk_through_epochs_and_drop_the_rest():
    key, rows = jax.random.key(1), jnp.arange(4)
    steps = [np.asarray(batch_items(key, step, rows, num_items=10, batch_size=4)) for step in range(4)]
    first, second = np.concatenate(steps[:2]), np.concatenate(steps[2:])
    assert len(set(first)) == len(set(second)) == 8
    np.testing.assert_array_equal(first, order(jax.random.fold_in(key, 0), 10)[:8])
    np.testing.assert_array_equal(second, order(jax.random.fold_in(key, 1), 10)[:8])


def test_a_small_data_set_fills_the_batch_by_repeating():
    items = np.asarray(batch_items(jax.random.key(1), 7, jnp.arange(8), num_items=3, batch_size=8))
    assert np.bincount(items, minlength=3).tolist() in ([3, 3, 2], [3, 2, 3], [2, 3, 3])


def test_items_come_as_often_as_their_shares_say():
    weights = np.array([0.5, 2.25, 1.0, 0.25, 1.0])
    shares = jnp.asarray(np.cumsum(weights) / weights.sum(), jnp.float32)
    items_at = jax.jit(functools.partial(shared_items, jax.random.key(2), shares=shares, batch_size=5))
    epochs = np.stack([np.bincount(items_at(step, jnp.arange(5)), minlength=5) for step in range(400)])
    # In each epoch nearly as often, and on average exactly.
    assert (np.abs(epochs - weights) < 1).all() and len(np.unique(epochs, axis=0)) > 2
    np.testing.assert_allclose(epochs.mean(axis=0), weights, atol=0.1)


def test_shared_items_are_a_function_of_key_step_and_row():
    shares = jnp.linspace(0.0, 1.0, 12)[1:] ** 2
    items_at = functools.partial(shared_items, jax.random.key(5), 6, shares=shares, batch_size=8)
    whole = items_at(jnp.arange(8))
    for rows in ([0, 1, 2, 3], [6], [7, 0, 3]):
        np.testing.assert_array_equal(items_at(jnp.array(rows)), whole[jnp.array(rows)])
    assert not np.array_equal(whole, shared_items(jax.random.key(6), 6, jnp.arange(8), shares, batch_size=8))


@pytest.mark.parametrize("num_items", [3, 11, 64])
def test_rows_do_not_depend_on_which_others_are_asked_for(num_items):
    items_at = functools.partial(batch_items, jax.random.key(5), 6, num_items=num_items, batch_size=8)
    whole, whole_keys = items_at(jnp.arange(8)), row_keys(jax.random.key(5), 6, jnp.arange(8))
    for rows in ([0, 1, 2, 3], [4, 5, 6, 7], [6], [7, 0, 3]):
        np.testing.assert_array_equal(items_at(jnp.array(rows)), whole[jnp.array(rows)])
        keys = row_keys(jax.random.key(5), 6, jnp.array(rows))
        np.testing.assert_array_equal(bits(keys), bits(whole_keys)[rows])


def test_every_row_of_every_step_has_a_key_of_its_own():
    keys = [bits(row_keys(jax.random.key(seed), step, jnp.arange(8))) for seed in range(3) for step in range(5)]
    assert len(np.unique(np.concatenate(keys), axis=0)) == 3 * 5 * 8


def test_numbers_are_drawn_below_the_limit_of_their_row():
    limits = jnp.tile(jnp.array([1, 2, 5]), 2000)
    found = np.asarray(draw_below(jax.random.split(jax.random.key(0), 6000), limits)).reshape(-1, 3)
    for values, limit in zip(found.T, (1, 2, 5), strict=True):
        np.testing.assert_allclose(np.bincount(values, minlength=limit) / 2000, 1 / limit, atol=0.04)


def test_split_keys_differ_and_belong_to_their_row():
    keys = jax.random.split(jax.random.key(0), 4)
    parts = split_each(keys, 3)
    assert [part.shape for part in parts] == [(4,)] * 3
    assert len(np.unique(np.concatenate([bits(part) for part in (keys, *parts)]), axis=0)) == 4 * 4
    for part, alone in zip(parts, split_each(keys[2:3], 3), strict=True):
        np.testing.assert_array_equal(bits(part)[2:3], bits(alone))


@pytest.mark.slow
def test_jit_equals_eager():
    items_at = jax.jit(batch_items, static_argnames=("num_items", "batch_size"))
    assert_jit_equals_eager(items_at, jax.random.key(0), 9, jnp.arange(4), rtol=0, num_items=11, batch_size=4)
