"""Masks against NumPy."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.masks import mask_from_lengths, masked_mean
from tests.jit import assert_jit_equals_eager


@pytest.mark.parametrize("size", [1, 5])
def test_the_first_positions_are_true(size):
    lengths = jnp.array([0, 1, 3, 5, 9])
    expected = [[position < length for position in range(size)] for length in (0, 1, 3, 5, 9)]
    mask = assert_jit_equals_eager(jax.jit(partial(mask_from_lengths, size=size)), lengths)
    np.testing.assert_array_equal(mask, expected)
    assert mask.dtype == bool


def test_the_mean_is_over_true_positions_only():
    values = np.arange(12.0, dtype=np.float32).reshape(2, 3, 2)
    mask = np.array([[True, False, True], [False, False, True]])
    expected = values[mask].mean()
    assert expected != values.mean()
    found = assert_jit_equals_eager(jax.jit(masked_mean), jnp.asarray(values), jnp.asarray(mask)[..., None])
    np.testing.assert_allclose(found, expected)


def test_what_is_masked_has_no_influence_not_even_nan():
    values = jnp.array([1.0, jnp.nan, 3.0, jnp.inf])
    mask = jnp.array([True, False, True, False])
    assert masked_mean(values, mask) == 2.0
    gradient = jax.grad(lambda values: masked_mean(values, mask))(values)
    np.testing.assert_array_equal(gradient, [0.5, 0.0, 0.5, 0.0])


def test_the_mean_of_nothing_is_zero():
    assert masked_mean(jnp.ones(3), jnp.zeros(3, bool)) == 0.0
