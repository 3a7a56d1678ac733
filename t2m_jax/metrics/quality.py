"""What a viewer sees first: stretched bones, trembling, sliding feet, and a path that drifts.

All functions measure each clip of a batch. Positions are in the skeleton's unit with Y up, at the skeleton's frame
rate; results are in meters, seconds and degrees. What a clip is too short for, or never does, is 0.
"""

from typing import NamedTuple

import chex
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from t2m_jax.metrics.positions import Positions, joint_errors
from t2m_jax.motion.features import bone_vectors, facing
from t2m_jax.motion.skeleton import Skeleton

CONTACT_HEIGHT = 0.05
"""A foot joint that is lower than this above the floor for two frames touches it; meters."""
SKATING_SPEED = 0.5
"""A foot joint that touches the floor and moves faster than this skates; meters per second."""
FLOATING_HEIGHT = 0.05
"""A body floats if its lowest foot joint is higher than this above the floor; meters."""
PENETRATION_DEPTH = 0.03
"""A body is in the floor if its lowest foot joint is deeper than this; meters."""
FLOOR_QUANTILE = 0.01
"""The floor of a clip is this quantile of the heights of its foot joints."""


class MotionQuality(NamedTuple):
    """Measures of clips alone, without a reference."""

    bone_variation: Float[Array, " B"]
    """Standard deviation of a bone's length over time, as a share of its mean; mean over bones."""
    jerk: Float[Array, " B"]
    """Norm of a joint's third derivative, mean over joints and frames; m/s^3."""
    skating_ratio: Float[Array, " B"]
    """Share of the contacts in which a foot joint skates."""
    skating_speed: Float[Array, " B"]
    """Mean speed of foot joints in contact over the ground; m/s."""
    floating: Float[Array, " B"]
    """Share of frames in which the body floats."""
    penetration: Float[Array, " B"]
    """Share of frames in which the body is in the floor."""


class MotionErrors(NamedTuple):
    """Differences of clips from their references."""

    mpjpe: Float[Array, " B"]
    """Mean distance of joints, with the roots of each frame aligned; meters."""
    global_mpjpe: Float[Array, " B"]
    """Mean distance of joints, with the root and the heading of the first frame aligned; meters."""
    acceleration_error: Float[Array, " B"]
    """Mean distance of the second differences of joints; meters per squared frame."""
    path_drift: Float[Array, " B"]
    """Distance over the ground of the roots in the last frame, with the first frame aligned; meters."""
    heading_drift: Float[Array, " B"]
    """Difference of the turns from the first frame to the last; degrees."""


def measure_quality(positions: Positions, mask: Bool[Array, "B T"], *, skeleton: Skeleton) -> MotionQuality:
    """Returns the quality of clips; `mask` is True in their frames, which come first."""
    chex.assert_shape(positions, (None, None, skeleton.num_joints, 3))
    chex.assert_shape(mask, positions.shape[:2])
    positions = positions * skeleton.metres_per_unit
    feet = positions[:, :, jnp.array(skeleton.left_foot + skeleton.right_foot)]
    height = feet[..., 1] - _floor(feet[..., 1], mask)
    low = (height < CONTACT_HEIGHT) & mask[:, :, None]
    # In one low frame alone, a foot may only swing past the floor.
    touching = low[:, 1:] & low[:, :-1]
    speed = jnp.linalg.norm(jnp.diff(feet[..., ::2], axis=1), axis=-1) * skeleton.fps
    lowest = jnp.min(height, axis=-1)
    return MotionQuality(
        bone_variation=_bone_variation(positions, mask, skeleton),
        jerk=_mean_difference(positions, mask, order=3) * skeleton.fps**3,
        skating_ratio=_clip_mean(speed > SKATING_SPEED, touching),
        skating_speed=_clip_mean(speed, touching),
        floating=_clip_mean(lowest > FLOATING_HEIGHT, mask),
        penetration=_clip_mean(lowest < -PENETRATION_DEPTH, mask),
    )


def measure_errors(
    positions: Positions, reference: Positions, mask: Bool[Array, "B T"], *, skeleton: Skeleton
) -> MotionErrors:
    """Returns how far clips are from their references; `mask` is True in their frames, which come first."""
    chex.assert_shape([positions, reference], (*mask.shape, skeleton.num_joints, 3))
    positions = positions * skeleton.metres_per_unit
    reference = reference * skeleton.metres_per_unit
    acceleration_error = _mean_difference(positions - reference, mask, order=2)
    apart = _from_first_frame(positions, skeleton) - _from_first_frame(reference, skeleton)
    last = jnp.maximum(jnp.sum(mask, axis=1) - 1, 0)
    drift = jnp.linalg.norm(apart[:, :, 0, ::2], axis=-1)
    headings = _headings(positions, skeleton) - _headings(reference, skeleton)
    turn = headings - headings[:, :1]
    # From -180 to 180 degrees, so that a turn to the right is not taken for a long one to the left.
    wrapped = jnp.abs((turn + jnp.pi) % (2 * jnp.pi) - jnp.pi)
    return MotionErrors(
        mpjpe=_clip_mean(joint_errors(positions, reference), mask),
        global_mpjpe=_clip_mean(jnp.linalg.norm(apart, axis=-1), mask[:, :, None]),
        acceleration_error=acceleration_error,
        path_drift=jnp.take_along_axis(drift, last[:, None], axis=1)[:, 0],
        heading_drift=jnp.rad2deg(jnp.take_along_axis(wrapped, last[:, None], axis=1)[:, 0]),
    )


def _clip_mean(values: Array, mask: Bool[Array, "B ..."]) -> Float[Array, " B"]:
    """Returns the mean of each clip's values over its True positions, or 0 if there are none."""
    mask = jnp.broadcast_to(mask, values.shape)
    axes = tuple(range(1, values.ndim))
    return jnp.sum(jnp.where(mask, values, 0.0), axis=axes) / jnp.maximum(jnp.sum(mask, axis=axes), 1)


def _mean_difference(positions: Positions, mask: Bool[Array, "B T"], *, order: int) -> Float[Array, " B"]:
    """Returns the mean norm of the joints' differences over time of some order; all frames of each must be data."""
    sizes = jnp.linalg.norm(jnp.diff(positions, n=order, axis=1), axis=-1)
    # Frames come first, so a difference is one of data if its last frame is.
    return _clip_mean(sizes, mask[:, order:, None])


def _bone_variation(positions: Positions, mask: Bool[Array, "B T"], skeleton: Skeleton) -> Float[Array, " B"]:
    frames = mask[:, :, None]
    lengths = jnp.linalg.norm(bone_vectors(positions, skeleton), axis=-1)
    count = jnp.maximum(jnp.sum(frames, axis=1), 1)
    mean = jnp.sum(jnp.where(frames, lengths, 0.0), axis=1) / count
    squares = jnp.where(frames, (lengths - mean[:, None]) ** 2, 0.0)
    return jnp.mean(jnp.sqrt(jnp.sum(squares, axis=1) / count) / jnp.maximum(mean, 1e-6), axis=1)


def _floor(heights: Float[Array, "B T F"], mask: Bool[Array, "B T"]) -> Float[Array, "B 1 1"]:
    """Returns the height of each clip's floor, interpolated between the two nearest heights."""
    ordered = jnp.sort(jnp.where(mask[:, :, None], heights, jnp.inf).reshape(len(heights), -1), axis=1)
    place = FLOOR_QUANTILE * jnp.maximum(jnp.sum(mask, axis=1) * heights.shape[2] - 1, 0)
    below, above = (jnp.asarray(rounded(place), jnp.int32)[:, None] for rounded in (jnp.floor, jnp.ceil))
    low, high = (jnp.take_along_axis(ordered, index, axis=1) for index in (below, above))
    # Padding is infinite, and infinity minus infinity is NaN: equal heights are not interpolated.
    return jnp.where(high > low, low + (place[:, None] - below) * (high - low), low)[:, :, None]


def _headings(positions: Positions, skeleton: Skeleton) -> Float[Array, "B T"]:
    """Returns the angle from +Z to the forward direction of hips and shoulders, in radians."""
    forward = facing(positions, skeleton)
    return jnp.arctan2(forward[..., 0], forward[..., 2])


def _from_first_frame(positions: Positions, skeleton: Skeleton) -> Positions:
    """Returns clips that start with the root at the origin and the heading +Z."""
    positions = positions - positions[:, :1, :1]
    angle = _headings(positions[:, :1], skeleton)[:, :, None]
    cos = jnp.cos(angle)
    sin = jnp.sin(angle)
    x, y, z = jnp.moveaxis(positions, -1, 0)
    return jnp.stack([cos * x - sin * z, y, sin * x + cos * z], axis=-1)
