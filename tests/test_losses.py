"""Losses against the original's arrays."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.losses import (
    bone_loss,
    elementwise_loss,
    facing_loss,
    joint_loss,
    reconstruction_loss,
    token_accuracy,
    token_loss,
    token_weights,
    velocity_loss,
    world_loss,
)
from t2m_jax.motion.features import features_from_positions
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import HUMANML3D, make_layout
from tests.jit import assert_jit_equals_eager
from tests.motion.figures import walking_positions


@pytest.mark.parametrize("joints", [22, pytest.param(21, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", ["l1", "l2", "l1_smooth"])
def test_golden_losses(golden_dir, joints, kind):
    arrays = np.load(golden_dir / "t2m_gpt" / "losses.npz")
    prefix = f"J{joints}"
    pred, motion = (jnp.asarray(arrays[f"{prefix}/{name}"]) for name in ("pred", "gt"))
    mask = jnp.ones(pred.shape[:2], bool)
    positions = make_layout(joints).positions
    assert [positions.start, positions.stop] == arrays[f"{prefix}/vel_slice"].tolist()

    def total(pred):
        everything = reconstruction_loss(pred, motion, mask, kind=kind)
        joints_alone = reconstruction_loss(pred, motion, mask, kind=kind, features=positions)
        return everything + 0.02 * 0.37 + 0.5 * joints_alone, (everything, joints_alone)

    (loss, parts), gradient = jax.value_and_grad(total, has_aux=True)(pred)
    expected = [arrays[f"{prefix}/{kind}/{name}"] for name in ("recon", "vel")]
    np.testing.assert_allclose(parts, expected, rtol=1e-5)
    np.testing.assert_allclose(loss, arrays[f"{prefix}/{kind}/total_commit0.37"], rtol=1e-5)
    np.testing.assert_allclose(gradient, arrays[f"{prefix}/{kind}/grad_total"], atol=1e-7, rtol=1e-4)


def test_masked_frames_do_not_count():
    pred, motion = jnp.zeros((1, 4, 3)), jnp.array([[[1.0] * 3, [1.0] * 3, [9.0] * 3, [9.0] * 3]])
    mask = jnp.array([[True, True, False, False]])
    assert reconstruction_loss(pred, motion, mask, kind="l1") == 1.0


def test_smooth_l1_is_quadratic_below_one():
    np.testing.assert_allclose(elementwise_loss(jnp.array([0.5, -3.0]), "l1_smooth"), [0.125, 2.5])


def mean_loss(logits, targets, code_lengths, **options):
    """The loss of a whole batch."""
    return token_loss(logits, targets, token_weights(code_lengths, targets.shape[1], **options))


def test_every_motion_weighs_the_same():
    logits = jnp.zeros((2, 6, 4)).at[0, :, 0].set(10.0)
    targets = jnp.array([[0, 0, 0, 0, 0, 0], [1, 3, 4, 4, 4, 4]])
    loss = mean_loss(logits, targets, jnp.array([5, 1]))
    np.testing.assert_allclose(loss, (0.0 + np.log(4.0)) / 2, atol=1e-3)


def test_padding_does_not_count():
    logits = jax.random.normal(jax.random.key(0), (1, 5, 4))
    short = assert_jit_equals_eager(jax.jit(mean_loss), logits, jnp.array([[1, 2, 3, 0, 0]]), jnp.array([2]))
    other = mean_loss(logits.at[:, 3:].set(99.0), jnp.array([[1, 2, 3, 7, 7]]), jnp.array([2]))
    np.testing.assert_allclose(short, other)


def test_padding_may_be_infinite():
    logits = jax.random.normal(jax.random.key(0), (1, 5, 4)).at[:, 3:].set(jnp.nan)
    loss, gradient = jax.value_and_grad(mean_loss)(logits, jnp.array([[1, 2, 3, 0, 0]]), jnp.array([2]))
    assert np.isfinite(loss)
    assert np.all(np.isfinite(gradient[:, :3]))


def test_tokens_can_weigh_the_same():
    logits = jnp.zeros((2, 6, 4)).at[0, :, 0].set(10.0)
    targets = jnp.array([[0, 0, 0, 0, 0, 0], [1, 3, 4, 4, 4, 4]])
    loss = mean_loss(logits, targets, jnp.array([5, 1]), mean_over="tokens")
    np.testing.assert_allclose(loss, 2 * np.log(4.0) / 8, atol=1e-3)


def test_accuracy_is_the_weight_of_what_is_right():
    """All six of the first motion, and the first of the two of the second."""
    logits = jnp.zeros((2, 6, 4)).at[0, :, 0].set(10.0).at[1, :, 1].set(10.0)
    targets = jnp.array([[0, 0, 0, 0, 0, 0], [1, 3, 1, 1, 1, 1]])
    for mean_over, expected in (("tokens", 7 / 8), ("motions", 3 / 4)):
        weights = token_weights(jnp.array([5, 1]), 6, mean_over=mean_over)
        np.testing.assert_allclose(token_accuracy(logits, targets, weights), expected, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("mean_over", ["motions", "tokens"])
def test_weights_add_up_to_one_and_parts_to_the_whole(mean_over):
    lengths = jnp.array([5, 1, 0, 3])
    weights = token_weights(lengths, 6, mean_over=mean_over)
    np.testing.assert_allclose(np.sum(weights), 1.0, rtol=1e-6)
    np.testing.assert_array_equal(np.sum(np.asarray(weights) > 0, axis=1), lengths + 1)
    logits = jax.random.normal(jax.random.key(0), (4, 6, 9))
    targets = jax.random.randint(jax.random.key(1), (4, 6), 0, 9)
    for measure in (token_loss, token_accuracy):
        parts = [measure(logits[rows], targets[rows], weights[rows]) for rows in (slice(0, 1), slice(1, 4))]
        np.testing.assert_allclose(sum(parts), measure(logits, targets, weights), rtol=1e-6)


def velocity(pred, motion, mask, kind):
    return float(velocity_loss(pred, motion, mask, kind="l1", velocity=kind, positions=slice(1, 3)))


def test_the_two_meanings_of_velocity():
    motion, mask = jnp.zeros((1, 4, 5)), jnp.ones((1, 4), bool)
    shifted = motion.at[..., 1:3].set(2.0)
    assert velocity(shifted, motion, mask, "joint_positions") == 2.0
    assert velocity(shifted, motion, mask, "frame_difference") == 0.0
    moving = motion + jnp.arange(4.0)[None, :, None] * 3
    assert velocity(moving, motion, mask, "frame_difference") == 3.0


def test_differences_across_a_clips_end_do_not_count():
    motion = jnp.zeros((1, 4, 5))
    pred = motion.at[:, 2:].set(9.0)
    assert velocity(pred, motion, jnp.array([[True, True, False, False]]), "frame_difference") == 0.0
    assert velocity(pred, motion, jnp.array([[True, True, True, False]]), "frame_difference") == 4.5


LAYOUT = HUMANML3D.layout
NORMALIZER = Normalizer(jnp.full(263, 0.1), jnp.linspace(0.5, 2.0, 263))
IN_METERS = {"skeleton": HUMANML3D, "normalizer": NORMALIZER}


@pytest.fixture(scope="module")
def walk():
    """A normalized walk of 40 frames and its mask, of which the last 10 are padding."""
    motion = NORMALIZER.normalize(jnp.asarray(features_from_positions(walking_positions(41), HUMANML3D))[None])
    return motion, (jnp.arange(40) < 30)[None]


def moved(motion, columns, amount):
    """The motion with an amount in meters added to columns."""
    return motion.at[..., columns].add(amount / NORMALIZER.std[columns])


@pytest.mark.slow
def test_losses_in_meters_are_distances(walk):
    motion, mask = walk
    lifted = moved(motion, slice(LAYOUT.positions.start, LAYOUT.positions.start + 3), jnp.array([0.03, 0.0, 0.04]))
    assert joint_loss(lifted, motion, mask, **IN_METERS) == pytest.approx(0.05 / 21, rel=1e-4)
    # The left hip is the end of one bone and the beginning of another.
    assert bone_loss(lifted, motion, mask, **IN_METERS) == pytest.approx(2 * 0.05 / 21, rel=1e-4)
    for order in (1, 2):
        found = world_loss(lifted, motion, mask, order=order, **IN_METERS)
        assert found < 2e-3, "turning with the heading is all that moves a constant offset"


@pytest.mark.slow
def test_world_losses_contain_the_path(walk):
    motion, mask = walk
    faster = moved(motion, slice(LAYOUT.root_velocity.start + 1, LAYOUT.root_velocity.stop), 0.01)
    assert world_loss(faster, motion, mask, order=1, **IN_METERS) == pytest.approx(0.01, rel=1e-3)
    assert world_loss(faster, motion, mask, order=2, **IN_METERS) < 1e-3
    assert joint_loss(faster, motion, mask, **IN_METERS) == 0


def test_the_facing_loss_is_an_angle(walk):
    motion, mask = walk
    joints = NORMALIZER.denormalize(motion)[..., LAYOUT.positions].reshape(1, 40, 21, 3)
    cos, sin = np.cos(0.1), np.sin(0.1)
    turn = joints @ jnp.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]]) - joints
    turned = motion.at[..., LAYOUT.positions].add(
        turn.reshape(1, 40, 63) / NORMALIZER.std[LAYOUT.positions][None, None]
    )
    assert facing_loss(turned, motion, mask, **IN_METERS) == pytest.approx(0.1, rel=1e-3)
    raised = moved(motion, slice(LAYOUT.positions.start + 1, LAYOUT.positions.start + 2), 0.3)
    assert facing_loss(raised, motion, mask, **IN_METERS) < 1e-6


@pytest.mark.slow
@pytest.mark.release
@pytest.mark.parametrize(
    "measure",
    [
        joint_loss,
        functools.partial(world_loss, order=2),
        *(pytest.param(loss, marks=pytest.mark.release) for loss in (bone_loss, facing_loss)),
        pytest.param(functools.partial(world_loss, order=1), marks=pytest.mark.release),
    ],
)
def test_losses_in_meters_leave_out_padding_and_have_gradients_at_zero(walk, measure):
    motion, mask = walk

    def total(reconstruction):
        return measure(reconstruction, motion, mask, **IN_METERS)

    assert total(motion.at[:, 30:].add(9.0)) == 0
    gradient = jax.grad(total)(motion)
    assert jnp.all(jnp.isfinite(gradient))
    assert_jit_equals_eager(jax.jit(total), motion + 0.1)
