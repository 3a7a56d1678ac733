"""Laws of the sampling strategies."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.sampling.strategies import Greedy, Temperature, TopK, TopP, make_strategy
from tests.jit import assert_jit_equals_eager

LOGITS = jax.random.normal(jax.random.key(0), (4, 9))
MANY = jnp.broadcast_to(jnp.log(jnp.array([0.5, 0.3, 0.15, 0.05])), (4000, 4))


def shares(strategy, logits=MANY) -> np.ndarray:
    tokens = strategy(logits, jax.random.key(1))
    return np.bincount(np.asarray(tokens), minlength=logits.shape[1]) / len(logits)


@pytest.mark.parametrize("strategy", [TopK(k=1), TopP(p=1e-6), Temperature(temperature=1e-4)])
def test_the_narrowest_choice_is_greedy(strategy):
    expected = np.argmax(LOGITS, axis=-1)
    np.testing.assert_array_equal(Greedy()(LOGITS, jax.random.key(1)), expected)
    np.testing.assert_array_equal(strategy(LOGITS, jax.random.key(1)), expected)


@pytest.mark.parametrize("strategy", [Temperature(), TopK(k=4), TopK(k=99), TopP(p=1.0)])
def test_the_widest_choice_follows_the_softmax(strategy):
    np.testing.assert_allclose(shares(strategy), [0.5, 0.3, 0.15, 0.05], atol=0.03)


def test_top_k_and_top_p_cut_the_tail():
    np.testing.assert_allclose(shares(TopK(k=2)), [0.625, 0.375, 0, 0], atol=0.03)
    np.testing.assert_allclose(shares(TopP(p=0.9)), [0.526, 0.316, 0.158, 0], atol=0.03)


def test_temperature_flattens():
    weights = np.sqrt([0.5, 0.3, 0.15, 0.05])
    np.testing.assert_allclose(shares(Temperature(temperature=2.0)), weights / weights.sum(), atol=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("strategy", [Greedy(), Temperature(), TopK(k=3), TopP(p=0.8)])
def test_jit_equals_eager(strategy):
    assert_jit_equals_eager(jax.jit(strategy), LOGITS, jax.random.key(2))


def test_make_strategy():
    assert make_strategy(0.0) == Greedy()
    assert make_strategy(0.8) == Temperature(temperature=0.8)
    assert make_strategy(1.0, 5) == TopK(k=5)
    assert make_strategy(1.0, top_p=0.5) == TopP(p=0.5)
