"""Joint errors against a loop in NumPy, and their laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.metrics.positions import joint_errors, mpjpe
from tests.jit import assert_jit_equals_eager

POSITIONS = jax.random.normal(jax.random.key(0), (2, 5, 4, 3))
REFERENCE = jax.random.normal(jax.random.key(1), (2, 5, 4, 3))
MASK = jnp.array([[True] * 5, [True] * 2 + [False] * 3])


def test_mpjpe_is_the_mean_over_valid_frames():
    errors = []
    for batch, frame in zip(*np.nonzero(np.asarray(MASK)), strict=True):
        one, other = np.asarray(POSITIONS[batch, frame]), np.asarray(REFERENCE[batch, frame])
        errors.append(np.mean([np.linalg.norm((one[j] - one[0]) - (other[j] - other[0])) for j in range(4)]))
    np.testing.assert_allclose(mpjpe(POSITIONS, REFERENCE, MASK), np.mean(errors), rtol=1e-5)


def test_mpjpe_does_not_see_where_the_root_is():
    moved = POSITIONS + jax.random.normal(jax.random.key(2), (2, 5, 1, 3))
    np.testing.assert_allclose(mpjpe(moved, POSITIONS, MASK), 0.0, atol=1e-5)


def test_mpjpe_sees_orientation():
    turned = POSITIONS * jnp.array([-1.0, 1.0, -1.0])[None, None, None]
    assert mpjpe(turned, POSITIONS, MASK) > 0.5


def test_nothing_past_the_end_counts():
    spoiled = jnp.where(MASK[:, :, None, None], POSITIONS, 1e6)
    np.testing.assert_array_equal(mpjpe(spoiled, REFERENCE, MASK), mpjpe(POSITIONS, REFERENCE, MASK))


@pytest.mark.slow
def test_jit_equals_eager():
    calls = [(mpjpe, (POSITIONS, REFERENCE, MASK)), (joint_errors, (POSITIONS, REFERENCE))]
    for function, arguments in calls:
        compiled = assert_jit_equals_eager(jax.jit(function), *arguments)
        assert np.all(np.asarray(compiled) > 0), function
