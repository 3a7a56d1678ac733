"""The joints of HumanML3D at those of a file; those that the file lacks are placed by the proportions of a person."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.kinematics import line_to
from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import HUMANML3D, JOINT

World = Float[np.ndarray, "T S 3"]
"""Positions of the joints of a file."""
Joints = Float[np.ndarray, "T 22 3"]
"""Positions of the joints of HumanML3D."""
Placed = dict[str, Float[np.ndarray, "T 3"]]
"""Positions by the names of HumanML3D's joints."""

_SPINE = ("pelvis", "spine1", "spine2", "spine3", "neck")
SPINE_HEIGHTS = dict(zip(_SPINE, np.cumsum([HUMANML3D.bone_lengths[JOINT[name]] for name in _SPINE]), strict=True))
"""Length of the template's bones from the pelvis to each joint of the spine."""
# Place of a collar joint that the rig does not have: the part of the way from spine3 to the neck, and from there to
# the shoulder.
_COLLAR_UP = 0.5
_COLLAR_OUT = 0.45
# The neck is above the middle of the shoulders, by this part of the way from the pelvis to there.
_NECK_UP = 0.12
# The ball of a foot from the ankle, in lengths of the shin: ahead, and on along the shin.
_TOE_AHEAD = 0.31
_TOE_DOWN = 0.12


def place_joints(world: World, parents: Sequence[int], index: Mapping[str, int]) -> Joints:
    """Returns the joints of HumanML3D in each frame.

    Args:
        world: Positions of the joints of a file.
        parents: Their parents.
        index: Joints of HumanML3D with their places in the file. Some may be missing (see `OPTIONAL_JOINTS`).
    """
    joints = {joint: world[:, source] for joint, source in index.items()}
    _place_spine(joints, index, world, parents)
    chest, neck = joints["spine3"], joints["neck"]
    for side in ("left", "right"):
        if f"{side}_collar" not in joints:
            base = chest + _COLLAR_UP * (neck - chest)
            joints[f"{side}_collar"] = base + _COLLAR_OUT * (joints[f"{side}_shoulder"] - base)
        if f"{side}_foot" not in joints:
            joints[f"{side}_foot"] = _toes(joints, side)
    if "head" not in joints:
        joints["head"] = neck + 0.5 * (neck - chest)
    return np.stack([joints[name] for name in HUMANML3D.joint_names], axis=1).astype(np.float32)


def _place_spine(joints: Placed, index: Mapping[str, int], world: World, parents: Sequence[int]) -> None:
    """Adds the missing joints between pelvis and neck: on the file's own spine, with the template's proportions."""
    known = [name for name in _SPINE if name in index]
    for below, above in itertools.pairwise(known):
        first = index[below]
        line = line_to(index[above], parents)
        # In some files, the upper joint is not a descendant of the lower one.
        chain = line[line.index(first) :] if first in line else [first, index[above]]
        path = world[:, chain]
        lengths = np.linalg.norm(np.diff(path, axis=1), axis=-1).mean(axis=0)
        ends = np.cumsum(lengths)
        for name in _SPINE[_SPINE.index(below) + 1 : _SPINE.index(above)]:
            place = _share(name, below, above) * lengths.sum()
            segment = min(int(np.searchsorted(ends, place)), len(lengths) - 1)
            weight = 1 - (ends[segment] - place) / max(lengths[segment], 1e-9)
            joints[name] = path[:, segment] * (1 - weight) + path[:, segment + 1] * weight
    if "neck" not in joints:
        _place_neck(joints, top=known[-1])


def _share(name: str, below: str, above: str) -> float:
    """Returns where the template has a joint of the spine: the part of the way from a lower to a higher one."""
    return (SPINE_HEIGHTS[name] - SPINE_HEIGHTS[below]) / (SPINE_HEIGHTS[above] - SPINE_HEIGHTS[below])


def _place_neck(joints: Placed, *, top: str) -> None:
    """Adds a neck above the shoulders, and the joints between it and the highest joint of the spine that is known."""
    shoulders = (joints["left_shoulder"] + joints["right_shoulder"]) / 2
    joints["neck"] = shoulders + _NECK_UP * (shoulders - joints["pelvis"])
    for name in _SPINE[_SPINE.index(top) + 1 : -1]:
        joints[name] = joints[top] + _share(name, top, "neck") * (joints["neck"] - joints[top])


def _toes(joints: Placed, side: str) -> Float[np.ndarray, "T 3"]:
    """Returns the ball of a foot that a file does not have: ahead of the ankle, at a right angle to the shin."""
    ankle = joints[f"{side}_ankle"]
    shin = ankle - joints[f"{side}_knee"]
    length = np.linalg.norm(shin, axis=-1, keepdims=True)
    left = joints["left_hip"] - joints["right_hip"]
    return ankle + length * _TOE_AHEAD * unit_vectors(np.cross(shin, left)) + _TOE_DOWN * shin
