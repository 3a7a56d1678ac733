"""The tests of this folder compile as users do."""

import os

import jax
import jax.numpy as jnp


def test_programs_are_optimized():
    program = jax.jit(lambda values: jnp.sum(jnp.exp(values) * 2 + 1)).lower(jnp.ones(64)).compile().as_text()
    assert "fusion" in program
    assert "JAX_DISABLE_MOST_OPTIMIZATIONS" not in os.environ
