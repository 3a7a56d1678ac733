"""A motion that goes on smoothly from another: inertialization, as in games (Bollo, GDC 2018).

The frames after a join begin with the pose and the velocities of the motion before it. What these differ by from their
own fades. It is a way of the hips and a turn of each bone, never a way of joints: so bones keep their lengths.
"""

import itertools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from t2m_jax.motion.features import bone_vectors, positions_from_bones
from t2m_jax.motion.kinematics import rigid_rotations
from t2m_jax.motion.legs import move_foot, reaching_bends
from t2m_jax.motion.rotations import quaternion_between, unit_vectors
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.motion.torso import hub_bones, torso_frames

HUB_AXIS = 0.005
"""Length of the axes of the torso that are fitted together with the bones of pelvis and chest. If these are nearly
parallel, they alone do not say how a pelvis or a chest is turned about them; meters."""
MOST_CARRIED = 0.8
"""How far hips and bones go on by their velocity, in meters and radians. More is an error of a recording, in which a
limb turns over in one frame."""

Clip = Float[np.ndarray, "_ J 3"]
"""Positions of a motion's joints."""
Pose = Float[np.ndarray, "J 3"]
"""Positions of one frame."""


def fade(time: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Returns the share of what follows: 0 until time 0, 1 from time 1, between them a cubic curve, level at both."""
    time = np.clip(time, 0, 1)
    # Smoothstep. After a linear cross-fade, velocities would jump at both ends.
    return time**2 * (3 - 2 * time)


def fading_change(
    change: Float[np.ndarray, "N 3"], speed: Float[np.ndarray, "N 3"], count: int
) -> Float[np.ndarray, "_ N 3"]:
    """Returns what to add to the `count` frames after a join, so that they follow smoothly from the frames before it.

    Args:
        change: What the last frame before the join differs by from the one that leads to the frames after it.
        speed: What the velocities there differ by, per frame.
        count: Frames in which a cubic curve goes from this difference and its velocity to zero.
    """
    time = (np.arange(1, count + 1) / (count + 1))[:, None, None]
    # A cubic Hermite curve. `speed` is per frame, and time goes from 0 to 1 in `count` + 1 frames.
    return (1 - fade(time)) * change + (count + 1) * time * (1 - time) ** 2 * speed


class Moment(NamedTuple):
    """A frame of a motion, and how the figure moves in it."""

    pose: Pose
    velocity: Float[np.ndarray, "J 3"]
    """Per frame: of the middle between the hips, and of each bone the axis of its turn times the angle in radians."""
    acceleration: Float[np.ndarray, "J 3"]
    """Change of these velocities from one frame to the next. Infinite if they are not known."""

    @classmethod
    def at_end(cls, frames: Clip, skeleton: Skeleton) -> "Moment":
        """Returns the last frame of a motion. The velocity of a single frame is not known."""
        pairs = list(itertools.pairwise(frames[-3:]))
        if not pairs:
            return cls(frames[-1], np.zeros(frames.shape[1:]), np.full(frames.shape[1:], np.inf))
        steps = [pose_change(pose, after, skeleton) for pose, after in pairs]
        acceleration = steps[-1] - steps[0]
        # A step is the velocity half a frame before its end, so half of the acceleration follows.
        return cls(frames[-1], steps[-1] + acceleration / 2, acceleration)

    @classmethod
    def at_start(cls, frames: Clip, skeleton: Skeleton) -> "Moment":
        """Returns the first frame of a motion."""
        backward = cls.at_end(frames[2::-1], skeleton)
        return backward._replace(velocity=-backward.velocity)


def pose_change(pose: Pose, goal: Pose, skeleton: Skeleton) -> Float[np.ndarray, "J 3"]:
    """Returns how to change a pose into another one: the way of the hips, and the smallest turn of each bone.

    A turn is its axis times its angle in radians. Pelvis and chest turn as one piece each.
    """
    from scipy.spatial.transform import Rotation  # here, because it takes long to import

    poses = np.stack([pose, goal]).astype(np.float64)
    bones, goal_bones = bone_vectors(poses, skeleton)
    axes, goal_axes = HUB_AXIS * torso_frames(poses, skeleton)
    turns = Rotation.from_quat(np.roll(quaternion_between(bones, goal_bones), -1, axis=-1)).as_rotvec()
    for hub in hub_bones(skeleton):
        vectors, goals = np.concatenate([bones[hub], axes]), np.concatenate([goal_bones[hub], goal_axes])
        turns[hub] = Rotation.from_matrix(rigid_rotations(vectors, goals)).as_rotvec()
    return np.concatenate([np.diff(_hips(poses, skeleton), axis=0), turns])


def _hips(positions: Clip, skeleton: Skeleton) -> Float[np.ndarray, "_ 3"]:
    """Returns the middle between the hips."""
    return positions[:, list(skeleton.face_joints[:2])].mean(axis=1)


def follow_on(clip: Clip, before: Moment, own: Moment, *, count: int, skeleton: Skeleton) -> Clip:
    """Returns a clip whose first `count` frames follow smoothly from the pose and the velocities of another motion.

    Each bone turns by what it differs by, and by less in each frame: the shortest way, so no bone turns over, however
    different the poses are.

    Args:
        clip: Frames after the join.
        before: Last frame of the motion before the join.
        own: The frame in its place that leads to the clip.
        count: Frames until the clip is as it was; with 0, all of it stays.
        skeleton: Of both.
    """
    from scipy.spatial.transform import Rotation  # here, because it takes long to import

    if count == 0:
        return clip
    changed = clip[:count].astype(np.float64)
    bones = bone_vectors(changed, skeleton)
    change = pose_change(own.pose, before.pose, skeleton)
    own_velocity = np.concatenate([own.velocity[:1], Rotation.from_rotvec(change[1:]).apply(own.velocity[1:])])
    speed = np.isfinite(before.acceleration + own.acceleration) * (before.velocity - own_velocity)
    fading = fading_change(change, 0 * change, count)[: len(changed)]
    carried = fading_change(0 * change, speed, count)
    carried *= MOST_CARRIED / np.linalg.norm(carried, axis=-1, keepdims=True).max(axis=0).clip(MOST_CARRIED)
    carried = carried[: len(changed)]
    # One after the other: the turn that carries the velocity on is in the world, after that of the pose.
    turns = [Rotation.from_rotvec(part[:, 1:].reshape(-1, 3)) for part in (carried, fading)]
    turned_bones = (turns[0] * turns[1]).apply(bones.reshape(-1, 3)).reshape(bones.shape)
    turned = positions_from_bones(changed[:, 0], turned_bones, skeleton)
    hips = _hips(changed, skeleton) + fading[:, 0] + carried[:, 0]
    return np.concatenate([turned + (hips - _hips(turned, skeleton))[:, None], clip[count:]])


def with_bones_of(beside: Clip, middle: Clip, skeleton: Skeleton) -> Clip:
    """Returns frames with the lengths of bones, and the shapes of pelvis and chest, of the first and last frame beside.

    If these two differ, as in motion as decoded, the lengths and shapes go from the first to the last.
    """
    share = (np.arange(1, len(middle) + 1) / (len(middle) + 1))[:, None, None]
    first, last = bone_vectors(beside, skeleton).astype(np.float64)[[0, -1]]
    first_lengths, last_lengths = np.linalg.norm([first, last], axis=-1, keepdims=True)
    turned = bone_vectors(middle, skeleton).astype(np.float64)
    axes, own_axes = (HUB_AXIS * torso_frames(part, skeleton) for part in (beside, middle))
    for hub in hub_bones(skeleton):
        rest = np.concatenate([first[hub], axes[0]])
        end = last[hub] @ rigid_rotations(rest, np.concatenate([last[hub], axes[-1]]))  # turned as the first
        turns = rigid_rotations(rest, np.concatenate([turned[:, hub], own_axes], axis=1))
        turned[:, hub] = ((1 - share) * first[hub] + share * end) @ np.swapaxes(turns, 1, 2)
    turned = unit_vectors(turned) * ((1 - share) * first_lengths + share * last_lengths)
    result = positions_from_bones(middle[:, 0], turned, skeleton)
    # With another pelvis, the root is elsewhere between the hips. The hips stay, and with them the feet.
    return result + (_hips(middle, skeleton) - _hips(result, skeleton))[:, None]


def feet_above(ground: Clip, clip: Clip, skeleton: Skeleton) -> Clip:
    """Returns a clip in which no ankle and no toe is lower than the lowest of either side in the frames `ground`.

    If hips sink while legs swing from one pose to another, feet go through the floor. There the foot is lifted as it
    is, and the knee bends. All other joints stay.
    """
    lifted = clip.copy()
    legs = [chain[1:] for chain in skeleton.chains if chain[1] in skeleton.face_joints[:2]]
    floors = np.min([ground[:, foot, 1].min(axis=0) for _, _, *foot in legs], axis=0)
    for hip, knee, *foot in legs:
        depth = np.max(floors - clip[:, foot, 1], axis=1, initial=0)
        if not (deep := depth > 0).any():
            continue
        way = jnp.asarray(depth[:, None] * [0.0, 1.0, 0.0], jnp.float32)
        start, hinge, end = (jnp.asarray(clip[:, joint], jnp.float32) for joint in (hip, knee, foot[0]))
        bent, ankle, _ = move_foot(start, hinge, end, end, way, reaching_bends(start, hinge, end, way))
        lifted[deep, knee] = bent[deep]
        lifted[np.ix_(deep, foot)] += np.asarray(ankle - end)[deep, None]
    return lifted
