"""Codebook figures against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np

from t2m_jax.metrics.codes import code_usage, perplexity
from tests.jit import assert_jit_equals_eager


def test_equal_use_of_all_codes():
    counts = jnp.full(8, 5)
    np.testing.assert_allclose(perplexity(counts), 8.0, rtol=1e-6)
    assert code_usage(counts) == 1.0


def test_one_code_alone():
    counts = jnp.array([0, 7, 0, 0])
    np.testing.assert_allclose(perplexity(counts), 1.0, rtol=1e-6)
    assert code_usage(counts) == 0.25


def test_no_code_at_all():
    counts = jnp.zeros(4, jnp.int32)
    assert code_usage(counts) == 0.0
    assert np.isfinite(perplexity(counts))


def test_jit_equals_eager():
    counts = jnp.array([3, 0, 1, 9])
    for function in (code_usage, perplexity):
        assert_jit_equals_eager(jax.jit(function), counts, rtol=1e-6)
