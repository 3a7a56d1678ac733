"""The motion of the 22 joints on a body with other proportions and another rest pose."""

import itertools
from collections.abc import Container
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from t2m_jax.motion.inverse_kinematics import fit_rig
from t2m_jax.motion.kinematics import forward_kinematics
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig.alignment import align, follow_trunk, is_t_pose
from t2m_jax.motion.rig.standing import Steps, leg_length
from t2m_jax.motion.rotations import (
    quaternion_between,
    quaternion_from_matrix,
    quaternion_multiply,
    rotate_vectors,
    unit_vectors,
)
from t2m_jax.motion.skeleton import HUMANML3D, JOINT

MAX_DROP = 0.2
"""Most that hips are lowered so that feet reach the floor, in lengths of a leg."""
DROP_SECONDS = 0.4
"""Time before and after a step in which hips are lowered for it, twice."""
STRETCH = 0.9999
"""Largest share of a leg's length between hip and ankle."""
_LEGS = tuple(tuple(JOINT[f"{side}_{name}"] for name in ("hip", "knee", "ankle")) for side in ("left", "right"))
_FEET = [JOINT["left_foot"], JOINT["right_foot"]]
_HIPS = [leg[0] for leg in _LEGS]
_SPINE = ("spine1", "spine2", "spine3")
_PELVIS = JOINT["pelvis"]
_UP = np.array([0.0, 1.0, 0.0])

Vectors = Float[np.ndarray, "T 3"]


class Movement(NamedTuple):
    """What moves a body from its rest pose."""

    turns: Float[np.ndarray, "T 22 4"]
    """Rotation of each joint from the rest pose, in the world."""
    pelvis: Float[np.ndarray, "T 3"]
    """Place of the pelvis in the unit of the body."""
    scale: float
    """Size of the body per size of the person in the motion."""


def transfer(
    motion: Motion, rest: Float[np.ndarray, "22 3"], bones: Container[str], *, same_joints: bool = False
) -> Movement:
    """Returns how a body moves as a motion does, on the floor at y = 0.

    Limbs have the directions that they have in the motion; for spine and collars, see `align`. The middle of the hips
    and the ankles are where the motion has them, scaled by the length of legs, and legs bend as needed for this.

    Args:
        motion: A motion of the 22 joints.
        rest: The joints of the body in its rest pose, in any unit.
        bones: Names of the joints at which the body has a bone; others were placed between these.
        same_joints: Whether the joints of the motion are at the same places in the body as these, also those of spine
            and collars, which differ between programs. It is so for a rest pose of this package.
    """
    same_joints = same_joints or is_t_pose(rest)
    rig = fit_rig(motion.positions, fps=motion.fps)
    poses = forward_kinematics(rig.rotations, rig.translations, HUMANML3D.parents)
    # Lengths are differences of places, and lose digits in single precision.
    positions, rest = np.asarray(motion.positions, np.float64), np.asarray(rest, np.float64)
    steps = Steps(motion, poses.rotations, rest, leg=leg_length(poses.positions[0]))
    aligned = align(poses.rotations, positions, rig.offsets, rest, foot_pitch=steps.pitch, same_joints=same_joints)
    turns = quaternion_multiply(quaternion_from_matrix(poses.rotations), aligned)
    _share_spine(turns, bones)
    if not same_joints:
        follow_trunk(turns, positions, rest)

    middle = steps.scale * positions[:, _HIPS].mean(axis=1) + steps.lift * _UP
    rest_middle = rest[_HIPS].mean(axis=0)
    hips = middle[:, None] + np.stack([_turned(turns, _PELVIS, rest[hip] - rest_middle) for hip in _HIPS], axis=1)
    feet = [(leg[2], rest[foot] - rest[leg[2]]) for leg, foot in zip(_LEGS, _FEET, strict=True)]
    soles = np.stack([_turned(turns, ankle, sole) for ankle, sole in feet], axis=1)
    ahead = np.stack([_turned(turns, ankle, steps.level(sole)) for ankle, sole in feet], axis=1)
    rolled = steps.rolled(soles, ahead)
    for side, (_, _, ankle) in enumerate(_LEGS):
        turns[:, ankle] = quaternion_multiply(quaternion_between(soles[:, side], rolled[:, side]), turns[:, ankle])
    ways = steps.ankles(rolled) - hips
    drop = _drop(ways, rest, steps.on_floor, motion.fps)[:, None] * _UP
    ahead = rotate_vectors(quaternion_from_matrix(poses.rotations[:, _HIPS]), np.array([0.0, 0.0, 1.0]))
    for side, joints in enumerate(_LEGS):
        _bend(turns, joints, rest, ways[:, side] + drop, ahead[:, side])
    place = middle - drop + _turned(turns, _PELVIS, rest[_PELVIS] - rest_middle)
    return Movement(turns, place.astype(np.float32), steps.scale)


def _share_spine(turns: Float[np.ndarray, "T 22 4"], bones: Container[str]) -> None:
    """Turns the highest bone of the spine as the chest, and what was placed on a bone as that bone."""
    highest = max((name for name in _SPINE if name in bones), default=_SPINE[0])
    turns[:, JOINT[highest]] = turns[:, JOINT[_SPINE[-1]]]
    for below, name in itertools.pairwise(("pelvis", *_SPINE)):
        if name not in bones:
            turns[:, JOINT[name]] = turns[:, JOINT[below]]


def _turned(turns: Float[np.ndarray, "T 22 4"], joint: int, vector: Float[np.ndarray, "3"]) -> Vectors:
    return np.asarray(rotate_vectors(turns[:, joint], vector), np.float64)


def _drop(
    ways: Float[np.ndarray, "T 2 3"], rest: Float[np.ndarray, "22 3"], standing: Bool[np.ndarray, "T 2"], fps: float
) -> Float[np.ndarray, " T"]:
    """Returns how far to lower the hips, so that feet which are on the floor are near enough."""
    lengths = np.array([np.linalg.norm(np.diff(rest[list(leg)], axis=0), axis=1).sum() for leg in _LEGS])
    below = np.sqrt(np.maximum((STRETCH * lengths) ** 2 - ways[..., 0] ** 2 - ways[..., 2] ** 2, 0))
    needed = np.where(standing, -ways[..., 1] - below, 0.0).max(axis=1).clip(0, MAX_DROP * lengths.mean())
    # Hips that drop in one frame would look like a stumble.
    reach = round(DROP_SECONDS * fps)
    # The mean of what is largest nearby is enough in every frame, and changes slowly.
    for reduce in (np.max, np.mean):
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(needed, reach, mode="edge"), 2 * reach + 1)
        needed = reduce(windows, axis=1)
    return needed


def _bend(
    turns: Float[np.ndarray, "T 22 4"],
    leg: tuple[int, ...],
    rest: Float[np.ndarray, "22 3"],
    way: Vectors,
    ahead: Vectors,
) -> None:
    """Turns thigh and shin so that the ankle is at `way` from the hip, as far as the leg reaches.

    Args:
        turns: Of all joints; those of hip and knee are changed.
        leg: Hip, knee and ankle.
        rest: The joints in the rest pose.
        way: From the hip to where the ankle should be.
        ahead: Where the knee points, for legs that are straight.
    """
    hip, knee, ankle = leg
    thigh, shin = (_turned(turns, first, rest[last] - rest[first]) for first, last in ((hip, knee), (knee, ankle)))
    upper, lower = (float(np.linalg.norm(rest[a] - rest[b])) for a, b in ((hip, knee), (knee, ankle)))
    distance = np.linalg.norm(way, axis=-1, keepdims=True)
    direction = unit_vectors(way)
    # Neither folded nor stretched completely, where the knee would have no direction.
    reach = np.clip(distance, abs(upper - lower) + 1e-3 * upper, STRETCH * (upper + lower))
    along = (upper**2 - lower**2 + reach**2) / (2 * reach)
    # The side on which the knee is. Of a nearly straight leg that has to bend, the axis of the joint says more.
    moved = np.linalg.norm(way - thigh - shin, axis=-1, keepdims=True)
    side = _across(thigh, direction) + moved * _across(ahead, direction)
    new_thigh = along * direction + np.sqrt(np.maximum(upper**2 - along**2, 0)) * unit_vectors(side)
    for joint, old, new in ((hip, thigh, new_thigh), (knee, shin, reach * direction - new_thigh)):
        turns[:, joint] = quaternion_multiply(quaternion_between(old, new), turns[:, joint])


def _across(vectors: Vectors, direction: Vectors) -> Vectors:
    """Returns the part of vectors that is perpendicular to unit directions."""
    return vectors - np.sum(vectors * direction, axis=-1, keepdims=True) * direction
