"""What the joints of a clip say about it: which axis is up, whether left is left, and where a rest pose ends."""

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import JOINT

Up = Literal["auto", "y", "z"]
"""The axis that points up: found from the figure, or given."""

UPRIGHT = 0.8
"""A figure stands along an axis if the line from its feet to its neck is this much along it (cosine)."""
BENT = 0.4
"""The same for a figure whose rest pose stands along this axis, and which may bend."""
LYING_RISE = 0.5
"""The hips of a figure that lies in all frames rise and fall less than this; meters."""
STEPS_TRAVEL = 1.0
"""The hips get farther than this only by steps, since the feet stay below them; meters."""
STILL_FOOT = 0.4
"""Whoever walks has a foot at rest: one of its joints moves less than this part of the way of the hips (0.2 in median
of 103 recordings, and rarely over 0.6; in those of people who crawl, 0.3 to 1.1)."""
LEVEL_FEET = 0.15
"""The lower foot of a walk rises and falls less than this in most frames; meters."""
SELDOM = 0.05
"""A figure whose pose is along an axis in less than this share of its frames has a rest pose there."""
POP_SPEED = 3.0
"""A frame is a rest pose before the motion if the joints then move faster than this; meters per second."""
POP_RATIO = 5.0
"""They must also move this many times as fast as in the next frames."""
T_POSE_RATIO = 2.0
"""The same after a T-pose, for the fastest joint. Arms are lowered slowly at first."""
NEXT_FRAMES = 5
FLOOR_TOLERANCE = 0.05
"""Joints are above soles, so the lowest joint of a figure that stands on the floor is near y = 0; meters."""
FLOOR_QUANTILE = 0.05
"""The floor is this quantile of the heights of the lowest joint: jumps are above it, and wrong frames below."""
T_POSE = 0.9
"""Arms are spread and legs are straight if they are this much along their axes (cosine)."""
MAX_REST_SECONDS = 2.0
"""Longest T-pose before a motion."""


def _upward(positions: Float[np.ndarray, "T 22 3"]) -> Float[np.ndarray, "T 3"]:
    """Returns the direction from the feet to the neck."""
    feet = (positions[:, JOINT["left_ankle"]] + positions[:, JOINT["right_ankle"]]) / 2
    return unit_vectors(positions[:, JOINT["neck"]] - feet)


def find_up(positions: Float[np.ndarray, "T 22 3"], rest: Float[np.ndarray, "22 3"]) -> Literal["y", "z"] | None:
    """Returns the axis that points up, None if the figure may stand along Z or lie along it.

    Args:
        positions: The motion.
        rest: The pose without rotations, in which most figures stand.
    """
    upward = _upward(positions)
    stands_y, stands_z = (float(np.mean(upward[:, axis] > UPRIGHT)) for axis in (1, 2))
    rests_y, rests_z = (bool(_upward(rest[None])[0, axis] > UPRIGHT) for axis in (1, 2))
    # Whoever lies does not rise and fall so far, but in some files, the rest pose alone has Y up.
    rises = float(np.ptp(positions[:, JOINT["pelvis"], 1]))
    if rests_y and stands_y < SELDOM and stands_z > UPRIGHT and (rises > LYING_RISE or _walks_along_z(positions)):
        return None
    # A rest pose that stands along Y settles it, also for a figure that lies in every frame.
    if rests_y or (stands_y > 0 and stands_y >= stands_z):
        return "y"
    if rests_z and stands_z > 0:
        return "z"
    if stands_z > UPRIGHT and rises > LYING_RISE and _walks_along_z(positions):
        return "z"
    # Somebody who crouches in a single pose still has the feet below the neck.
    _, along_y, along_z = upward.mean(axis=0)
    if rests_z and along_z > max(abs(along_y), BENT):
        return "z"
    return None if rests_z or stands_z > 0 else "y"


def stands_along_z_alone(positions: Float[np.ndarray, "T 22 3"], rest: Float[np.ndarray, "22 3"]) -> bool:
    """Returns whether a figure lies in all frames if Y is up, but stands if Z is, as in its rest pose."""
    upward = _upward(positions)
    stands_z = _upward(rest[None])[0, 2] > UPRIGHT and np.any(upward[:, 2] > UPRIGHT)
    return bool(stands_z and np.all(upward[:, 1] < BENT))


def _walks_along_z(positions: Float[np.ndarray, "T 22 3"]) -> bool:
    """Returns whether a figure goes on level feet, one of which is at rest, if Z is up."""
    feet = positions[:, [JOINT[f"{side}_{name}"] for side in ("left", "right") for name in ("ankle", "foot")]]
    hips = positions[:, JOINT["pelvis"], :2]
    steps = np.linalg.norm(np.diff(feet, axis=0), axis=-1).min(axis=1).sum()
    level = np.ptp(np.quantile(feet[..., 2].min(axis=1), (FLOOR_QUANTILE, 1 - FLOOR_QUANTILE)))
    is_at_rest = steps < STILL_FOOT * np.linalg.norm(np.diff(hips, axis=0), axis=-1).sum()
    return bool(is_at_rest and level < LEVEL_FEET and np.linalg.norm(np.ptp(hips, axis=0)) > STEPS_TRAVEL)


def to_y_up(positions: Float[np.ndarray, "T 22 3"]) -> Float[np.ndarray, "T 22 3"]:
    """Returns motion in which Z is up, turned so that Y is up."""
    return positions[..., [0, 2, 1]] * np.array([1, 1, -1], positions.dtype)


def on_floor(positions: Float[np.ndarray, "T 22 3"]) -> Float[np.ndarray, "T 22 3"]:
    """Returns motion with Y up whose floor is at y = 0, where the lowest joint of most frames is.

    Files that have it there already are not changed. Others have their origin at the hips, at a place of the room, or
    above a floor that was not measured.
    """
    floor = float(np.quantile(positions[..., 1].min(axis=1), FLOOR_QUANTILE))
    if abs(floor) <= FLOOR_TOLERANCE:
        return positions
    return positions - np.array([0.0, floor, 0.0], positions.dtype)


def left_is_left(positions: Float[np.ndarray, "T 22 3"]) -> Bool[np.ndarray, " T"]:
    """Returns for each frame whether the joints that are called left are on the left.

    Knees bend backwards and feet point ahead, so both turn about an axis that points to the left of the body. This does
    not depend on where the figure stands or lies.
    """
    left = np.zeros_like(positions[:, 0])
    for side in ("left", "right"):
        hip, knee, ankle, foot = (positions[:, JOINT[f"{side}_{name}"]] for name in ("hip", "knee", "ankle", "foot"))
        thigh, shin, sole = map(unit_vectors, (knee - hip, ankle - knee, foot - ankle))
        left += np.cross(thigh, shin) + np.cross(sole, shin)
    # Turned axes of the limbs against the line between the hips: the same direction if left is left.
    across = positions[:, JOINT["left_hip"]] - positions[:, JOINT["right_hip"]]
    return np.sum(across * left, axis=-1) > 0


def sides_note(positions: Float[np.ndarray, "T 22 3"]) -> str:
    """Returns what to say if left and right may be exchanged; nothing otherwise."""
    # Most frames decide: in some, a leg is straight or a foot turned.
    if left_is_left(positions).mean() > 0.5:
        return ""
    return "LEFT AND RIGHT may be exchanged, as the knees bend and the feet point"


def rest_frames(positions: Float[np.ndarray, "T 22 3"], *, fps: float) -> int:
    """Returns the number of frames of a rest pose before the motion.

    It is one frame from which the whole figure jumps, or some frames of a T-pose from which at least one joint does.
    """
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=-1) * fps
    if len(steps) < 2:
        return 0
    # Some programs export the bind pose as frame 0, from which every joint jumps at once.
    if _jumps(steps.mean(axis=1), 0, ratio=POP_RATIO):
        return 1
    # Others let the actor begin in a T-pose.
    held = _in_t_pose(positions[: int(MAX_REST_SECONDS * fps) + 1])
    count = len(held) if held.all() else int(np.argmin(held))
    still = count > 0 and bool(np.all(steps[: count - 1].max(axis=1, initial=0.0) < POP_SPEED))
    return count if still and count < len(steps) and _jumps(steps.max(axis=1), count - 1, ratio=T_POSE_RATIO) else 0


def _jumps(speeds: Float[np.ndarray, " S"], step: int, *, ratio: float) -> bool:
    """Returns whether a step is much faster than those after it."""
    following = speeds[step + 1 : step + 1 + NEXT_FRAMES].max(initial=0.0)
    return bool(speeds[step] > max(POP_SPEED, ratio * following))


def _in_t_pose(positions: Float[np.ndarray, "T 22 3"]) -> Bool[np.ndarray, " T"]:
    """Returns for each frame whether the arms are spread and the legs are straight."""
    across = unit_vectors(positions[:, JOINT["left_shoulder"]] - positions[:, JOINT["right_shoulder"]])
    up = _upward(positions)
    found = np.ones(len(positions), bool)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        hip, ankle, shoulder, wrist = (
            positions[:, JOINT[f"{side}_{name}"]] for name in ("hip", "ankle", "shoulder", "wrist")
        )
        found &= np.sum(unit_vectors(wrist - shoulder) * across, axis=-1) * sign > T_POSE
        found &= np.sum(unit_vectors(hip - ankle) * up, axis=-1) > T_POSE
    return found
