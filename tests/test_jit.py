"""The comparison of jit and eager fails if a function is not compiled."""

import jax
import jax.numpy as jnp
import pytest

from tests.jit import assert_jit_equals_eager


def double(values):
    return 2 * values


def test_equal_results_pass():
    assert assert_jit_equals_eager(jax.jit(double), jnp.arange(3.0)).tolist() == [0, 2, 4]


def test_static_and_donated_arguments_and_keys_are_possible():
    def shifted(values, key, *, by, size):
        return values[:size] + by, key

    function = jax.jit(shifted, static_argnames="size", donate_argnums=0)
    values, _ = assert_jit_equals_eager(function, jnp.zeros(4), jax.random.key(1), by=1, size=4)
    assert values.tolist() == [1, 1, 1, 1]


def test_a_function_that_is_not_jitted_fails():
    with pytest.raises(AssertionError, match=r"not under jax\.jit"):
        assert_jit_equals_eager(double, jnp.arange(3.0))


def test_a_function_that_is_another_one_under_jit_fails():
    def differs(values):
        return values + isinstance(values, jax.core.Tracer)

    with pytest.raises(AssertionError, match="assert_trees_all_close failed"):
        assert_jit_equals_eager(jax.jit(differs), jnp.arange(3.0))
    with jax.disable_jit(), pytest.raises(AssertionError, match="assert_trees_all_close failed"):
        assert_jit_equals_eager(jax.jit(differs), jnp.arange(3.0))
