"""Joint errors against a loop in NumPy, and their laws."""

import jax
import jax.numpy as jnp
import numpy as np

from t2m_jax.metrics.positions import joint_errors, mpjpe, pa_mpjpe
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


def test_jit_equals_eager():
    calls = [(function, (POSITIONS, REFERENCE, MASK)) for function in (mpjpe, pa_mpjpe)]
    calls += [(joint_errors, (POSITIONS, REFERENCE))]
    for function, arguments in calls:
        compiled = assert_jit_equals_eager(jax.jit(function), *arguments)
        assert np.all(np.asarray(compiled) > 0), function


def rotation(key):
    return jnp.linalg.qr(jax.random.normal(key, (3, 3)))[0]


def test_procrustes_sees_no_rotation_scale_or_shift_but_reflection():
    turn = rotation(jax.random.key(3))
    turn = turn * jnp.sign(jnp.linalg.det(turn))
    moved = 1.7 * jnp.einsum("btji,ik->btjk", POSITIONS, turn) + jnp.arange(3.0)[None, None, None]
    np.testing.assert_allclose(pa_mpjpe(moved, POSITIONS, MASK), 0.0, atol=1e-5)
    mirrored = POSITIONS * jnp.array([-1.0, 1.0, 1.0])[None, None, None]
    assert pa_mpjpe(mirrored, POSITIONS, MASK) > 0.1


def test_procrustes_is_the_best_of_many_rotations():
    pose, reference = POSITIONS[:1, :1], REFERENCE[:1, :1]
    centred, target = pose - pose.mean(2, keepdims=True), reference - reference.mean(2, keepdims=True)

    def squares(turned):
        # Procrustes minimises squares: with the best scale of each rotation.
        scale = jnp.sum(turned * target) / jnp.sum(turned**2)
        return float(jnp.sum((scale * turned - target) ** 2))

    tried = []
    for seed in range(300):
        turn = rotation(jax.random.key(seed))
        tried.append(squares(jnp.einsum("btji,ik->btjk", centred, turn * jnp.sign(jnp.linalg.det(turn)))))
    left, strengths, right = np.linalg.svd(np.asarray(centred[0, 0]).T @ np.asarray(target[0, 0]))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    best = squares(jnp.asarray(np.asarray(centred) @ ((left * signs) @ right)))
    assert best <= min(tried) + 1e-5
    scale = (strengths * signs).sum() / float(jnp.sum(centred**2))
    errors = np.linalg.norm(
        scale * np.asarray(centred[0, 0]) @ ((left * signs) @ right) - np.asarray(target[0, 0]), axis=-1
    )
    np.testing.assert_allclose(pa_mpjpe(pose, reference, MASK[:1, :1]), errors.mean(), rtol=1e-4)
