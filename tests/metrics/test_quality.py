"""Quality of motion against its definitions in NumPy, clip by clip, and its laws."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.data import make_motion
from t2m_jax.metrics.quality import MotionErrors, MotionQuality, measure_errors, measure_quality
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML
from tests.jit import assert_jit_equals_eager

LENGTHS = (40, 23)
MASK = jnp.arange(40)[None] < jnp.array(LENGTHS)[:, None]
FEET = (7, 10, 8, 11)
quality = jax.jit(functools.partial(measure_quality, skeleton=HUMANML3D))
errors = jax.jit(functools.partial(measure_errors, skeleton=HUMANML3D))


def clips(*, noise: float = 0.0, seed: int = 0) -> jax.Array:
    """Returns a walk and a wave; the frames after the end of the wave are nonsense."""
    found = np.stack([make_motion(name, seed=seed, num_frames=40) for name in ("walk-turn-left", "wave-left-hand")])
    found = found + noise * np.random.default_rng(seed).normal(size=found.shape)
    found[1, LENGTHS[1] :] = 1e4
    return jnp.asarray(found, jnp.float32)


def quality_of_clip(positions):
    """Returns the measures of one clip by their definitions."""
    parents = HUMANML3D.parents[1:]
    bones = np.array(
        [np.linalg.norm(positions[:, j] - positions[:, parent], axis=1) for j, parent in enumerate(parents, 1)]
    )
    jerk = np.linalg.norm(np.diff(positions, n=3, axis=0), axis=-1).mean() * 20.0**3
    floor = np.percentile(positions[:, FEET, 1], 1)
    contacts = skating = speeds = 0
    for t in range(1, len(positions)):
        for j in FEET:
            if max(positions[t - 1, j, 1], positions[t, j, 1]) < floor + 0.05:
                speed = 20 * np.hypot(*(positions[t, j] - positions[t - 1, j])[[0, 2]])
                contacts, skating, speeds = contacts + 1, skating + (speed > 0.5), speeds + speed
    lowest = positions[:, FEET, 1].min(axis=1)
    return MotionQuality(
        bone_variation=(bones.std(axis=1) / bones.mean(axis=1)).mean(),
        jerk=jerk,
        skating_ratio=skating / contacts,
        skating_speed=speeds / contacts,
        floating=(lowest > floor + 0.05).mean(),
        penetration=(lowest < floor - 0.03).mean(),
    )


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_quality_is_what_it_is_defined_to_be(noise):
    positions = clips(noise=noise)
    positions = positions.at[0, 30:34, :, 1].add(0.3).at[0, 20, 10, 1].add(-0.2)
    found = quality(positions, MASK)
    expected = [quality_of_clip(np.asarray(positions[b, :length], np.float64)) for b, length in enumerate(LENGTHS)]
    for name, ours, theirs in zip(MotionQuality._fields, found, zip(*expected, strict=True), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-5, err_msg=name)
    assert found.penetration[0] > 0 and found.floating[0] > 0


def errors_of_clip(positions, reference):
    """Returns the errors of one clip by their definitions."""

    def aligned(clip):
        across = clip[:, 2] - clip[:, 1] + clip[:, 17] - clip[:, 16]
        forward = np.cross([0.0, 1.0, 0.0], across)
        headings = np.arctan2(forward[:, 0], forward[:, 2])
        cos, sin = np.cos(-headings[0]), np.sin(-headings[0])
        return (clip - clip[0, 0]) @ np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]]).T, headings - headings[0]

    (one, turn), (other, other_turn) = aligned(positions), aligned(reference)
    local = np.linalg.norm((positions - positions[:, :1]) - (reference - reference[:, :1]), axis=-1)
    turned = np.exp(1j * (turn[-1] - other_turn[-1]))
    return MotionErrors(
        mpjpe=local.mean(),
        global_mpjpe=np.linalg.norm(one - other, axis=-1).mean(),
        acceleration_error=np.linalg.norm(np.diff(positions - reference, n=2, axis=0), axis=-1).mean(),
        path_drift=np.linalg.norm((one - other)[-1, 0, [0, 2]]),
        heading_drift=abs(np.degrees(np.angle(turned))),
    )


def test_errors_are_what_they_are_defined_to_be():
    positions, reference = clips(noise=0.03, seed=3), clips(seed=1)
    found = errors(positions, reference, MASK)
    pairs = [[np.asarray(c[b, :n], np.float64) for c in (positions, reference)] for b, n in enumerate(LENGTHS)]
    expected = [errors_of_clip(*pair) for pair in pairs]
    for name, ours, theirs in zip(MotionErrors._fields, found, zip(*expected, strict=True), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, err_msg=name)
        assert (np.asarray(ours) > 0).all(), name


def test_global_errors_do_not_see_where_a_clip_starts():
    angle = 2.0
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    moved = jnp.asarray(np.asarray(clips()) @ turn.T + [3.0, 0.0, -2.0], jnp.float32)
    found = errors(moved, clips(), MASK)
    for name in ("global_mpjpe", "path_drift", "heading_drift"):
        np.testing.assert_allclose(getattr(found, name), 0.0, atol=2e-3, err_msg=name)


def test_a_rigid_body_at_constant_speed_is_quiet_and_on_the_ground():
    steps = np.arange(40)[:, None, None] * [0.04, 0.0, 0.0]
    found = quality(jnp.asarray(np.asarray(clips()[:, :1]) + steps, jnp.float32), MASK)
    for name in ("bone_variation", "floating", "penetration"):
        np.testing.assert_allclose(getattr(found, name), 0.0, atol=1e-5, err_msg=name)
    np.testing.assert_allclose(found.jerk, 0.0, atol=0.05)  # rounding, times 20^3
    np.testing.assert_allclose(found.skating_speed, 0.8, rtol=1e-3)
    np.testing.assert_allclose(found.skating_ratio, 1.0)


@pytest.mark.slow
def test_kit_is_measured_in_meters():
    """Its unit is the millimeter, and its frame rate another one."""
    pose = np.random.default_rng(0).normal(scale=300, size=(1, 1, 21, 3))
    positions = jnp.asarray(pose + np.arange(8)[:, None, None] ** 3 * [1.0, 0.0, 0.0], jnp.float32)
    mask = jnp.ones((1, 8), bool)
    np.testing.assert_allclose(measure_quality(positions, mask, skeleton=KIT_ML).jerk, 6e-3 * 12.5**3, rtol=1e-3)
    found = measure_errors(positions, jnp.tile(positions[:, :1], (1, 8, 1, 1)), mask, skeleton=KIT_ML)
    np.testing.assert_allclose(found.path_drift, 0.343, rtol=1e-3)
    gliding = jnp.asarray(np.abs(pose) * [1, 0, 1] + np.arange(8)[:, None, None] * [40.0, 0.0, 0.0], jnp.float32)
    np.testing.assert_allclose(measure_quality(gliding, mask, skeleton=KIT_ML).skating_speed, 0.04 * 12.5, rtol=1e-3)


def test_one_frame_and_an_empty_clip_have_finite_figures():
    for mask in (jnp.zeros((2, 40), bool), jnp.arange(40)[None] < jnp.ones((2, 1))):
        for found in (quality(clips(), mask), errors(clips(seed=1), clips(), mask)):
            assert all(np.isfinite(value).all() for value in found)


@pytest.mark.slow
def test_jit_equals_eager():
    assert_jit_equals_eager(quality, clips(noise=0.02), MASK)
    assert_jit_equals_eager(errors, clips(noise=0.02), clips(seed=1), MASK)
