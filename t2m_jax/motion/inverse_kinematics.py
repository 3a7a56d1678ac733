"""Fitting a rigid figure to joint positions: constant bone lengths, a T-pose as rest pose, a rotation per joint."""

import itertools
from typing import NamedTuple

import chex
import numpy as np
from jaxtyping import Float

from t2m_jax.motion.kinematics import rigid_rotations
from t2m_jax.motion.rotations import (
    matrix_from_quaternion,
    quaternion_between,
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_multiply,
    rotate_vectors,
    slerp,
    unit_vectors,
)
from t2m_jax.motion.skeleton import HUMANML3D, JOINT
from t2m_jax.motion.torso import HINT, torso_frames
from t2m_jax.motion.twist import limb_rotations

_PARENTS = HUMANML3D.parents
_X, _Y, _Z = np.eye(3)
RIGID_SWEEPS = 20
MIN_BONE = 0.05
"""Share of the mean bone of a figure. A shorter bone above a hub does not tell what is up: in some files, the spine
begins at the place of the pelvis. The whole torso tells it then."""

# Direction in the T-pose of the bone that ends at a joint. The other joints are children of pelvis and chest, and their
# directions are measured in the motion.
REST_DIRECTIONS = {"spine2": _Y, "spine3": _Y, "head": _Y}
for _side, _out in (("left", _X), ("right", -_X)):
    REST_DIRECTIONS |= {f"{_side}_knee": -_Y, f"{_side}_ankle": -_Y, f"{_side}_foot": _Z}
    REST_DIRECTIONS |= {f"{_side}_shoulder": _out, f"{_side}_elbow": _out, f"{_side}_wrist": _out}


class _Hub(NamedTuple):
    """A joint with three children: two to the sides, along X in the rest pose, and one above, along Y."""

    joint: int
    left: int
    right: int
    above: int


class _Limb(NamedTuple):
    """Three joints of a limb, and the axis about which its hinge bends in the rest pose."""

    start: int
    hinge: int
    end: int
    hinge_axis: Float[np.ndarray, "3"]


PELVIS = _Hub(*(JOINT[name] for name in ("pelvis", "left_hip", "right_hip", "spine1")))
CHEST = _Hub(*(JOINT[name] for name in ("spine3", "left_collar", "right_collar", "neck")))
# Knees bend backwards. The elbows of a T-pose with palms down bend forwards.
LEGS = tuple(_Limb(JOINT[f"{s}_hip"], JOINT[f"{s}_knee"], JOINT[f"{s}_ankle"], _X) for s in ("left", "right"))
ARMS = tuple(
    _Limb(JOINT[f"{s}_shoulder"], JOINT[f"{s}_elbow"], JOINT[f"{s}_wrist"], axis)
    for s, axis in (("left", -_Y), ("right", _Y))
)


class FittedRig(NamedTuple):
    """A moving figure of 22 joints. Its `forward_kinematics` is close to the positions that it was fitted to."""

    offsets: Float[np.ndarray, "J 3"]
    rotations: Float[np.ndarray, "T J 3 3"]
    root_positions: Float[np.ndarray, "T 3"]

    @property
    def translations(self) -> Float[np.ndarray, "T J 3"]:
        """Position of each joint in its parent's frame, and of the root in the world."""
        result = np.repeat(self.offsets[None], len(self.rotations), axis=0)
        result[:, 0] = self.root_positions
        return result


def fit_rig(positions: Float[np.ndarray, "T J 3"], *, fps: float) -> FittedRig:
    """Returns the rig of the 22 HumanML3D joints whose motion is closest to `positions`.

    Bone lengths are means over the clip. The rotations of head, wrists and toes are the identity.

    Args:
        positions: World positions in meters, Y up.
        fps: Frames per second.
    """
    chex.assert_shape(positions, (None, HUMANML3D.num_joints, 3))
    targets = np.asarray(positions, dtype=np.float64)
    offsets = _rest_offsets(targets)
    fit = _Fit(_rigid_positions(targets, offsets), offsets)
    fit.turn_hub(PELVIS)
    spine = (JOINT["spine1"], JOINT["spine2"])
    for joint in spine:
        fit.swing(joint)
    fit.turn_hub(CHEST)
    # The swings of the spine have no twist, so all of it is at the chest. Each of its joints gets a third.
    pelvis = fit.rotations[:, PELVIS.joint].copy()
    chest = fit.rotations[:, CHEST.joint].copy()
    for share, joint in zip((1 / 3, 2 / 3), spine, strict=True):
        fit.swing(joint, start=slerp(pelvis, chest, share))
    fit.set_rotation(CHEST.joint, chest)
    for collar in (CHEST.left, CHEST.right, CHEST.above):
        fit.swing(collar)
    # Both legs at once, and both arms: limbs of one kind are arrays of one shape.
    for limbs in (LEGS, ARMS):
        _fit_limbs(fit, limbs, fps)
    for leg in LEGS:
        fit.swing(leg.end)
    return FittedRig(
        offsets=fit.offsets.astype(np.float32),
        rotations=matrix_from_quaternion(fit.local_rotations()),
        root_positions=fit.joints[:, 0].astype(np.float32),
    )


class _Fit:
    """The joints and world rotations that were fitted so far, from the root outwards."""

    def __init__(self, targets: Float[np.ndarray, "T J 3"], offsets: Float[np.ndarray, "J 3"]):
        self.targets = targets
        self.offsets = offsets
        self.joints = targets.copy()
        self.rotations = np.zeros((*targets.shape[:2], 4), dtype=np.float32)
        self.rotations[..., 0] = 1

    def aim(self, joint: int) -> Float[np.ndarray, "T 3"]:
        """Returns the vector from the rig's `joint` to the target of its only child."""
        return self.targets[:, _only_child(joint)] - self.joints[:, joint]

    def set_rotation(self, joint: int, rotations: Float[np.ndarray, "T 4"]) -> None:
        """Sets the rotation of `joint` and moves its children accordingly."""
        self.rotations[:, joint] = rotations
        for child in HUMANML3D.children(joint):
            self.joints[:, child] = self.joints[:, joint] + rotate_vectors(rotations, self.offsets[child])
            self.rotations[:, child] = rotations  # final for leaves: the identity in the parent's frame

    def turn_hub(self, hub: _Hub) -> None:
        """Rotates a joint with several children to the best rigid fit."""
        children = list(HUMANML3D.children(hub.joint))
        targets = self.targets[:, children] - self.joints[:, hub.joint, None]
        rotations = _hub_rotations(hub, self.offsets[children], targets, self.targets)
        self.set_rotation(hub.joint, quaternion_from_matrix(rotations))

    def swing(self, joint: int, *, start: Float[np.ndarray, "T 4"] | None = None) -> None:
        """Rotates a joint with one child from `start`, by default its parent's rotation, directly to its target."""
        start = self.rotations[:, _PARENTS[joint]] if start is None else start
        bone = rotate_vectors(start, self.offsets[_only_child(joint)])
        self.set_rotation(joint, quaternion_multiply(quaternion_between(bone, self.aim(joint)), start))

    def local_rotations(self) -> Float[np.ndarray, "T J 4"]:
        """Returns all rotations in the parents' frames."""
        inverse_parents = quaternion_inverse(self.rotations[:, _PARENTS[1:]])
        inner = quaternion_multiply(inverse_parents, self.rotations[:, 1:])
        return np.concatenate((self.rotations[:, :1], inner), axis=1)


def _only_child(joint: int) -> int:
    (child,) = HUMANML3D.children(joint)
    return child


def _fit_limbs(fit: _Fit, limbs: tuple[_Limb, ...], fps: float) -> None:
    """Rotates the first two joints of limbs. Their twist follows from the plane of the bent hinge."""
    starts, hinges = ([getattr(limb, name) for limb in limbs] for name in ("start", "hinge"))
    for joint in (*starts, *hinges):  # moves the hinges, which the directions of the lower bones depend on
        fit.swing(joint)
    above = fit.rotations[:, [_PARENTS[joint] for joint in starts]]
    aims = [np.stack([fit.aim(joint) for joint in joints], axis=1) for joints in (starts, hinges)]
    upper, lower = (unit_vectors(rotate_vectors(quaternion_inverse(above), aim)) for aim in aims)
    local = limb_rotations(
        upper,
        lower,
        rest_directions=unit_vectors(fit.offsets[hinges]),
        hinge_axes=np.stack([limb.hinge_axis for limb in limbs]),
        fps=fps,
    )
    rotations = quaternion_multiply(above, local)
    for i, limb in enumerate(limbs):
        fit.set_rotation(limb.start, rotations[:, i])
        fit.swing(limb.hinge)


def _rest_offsets(positions: Float[np.ndarray, "T J 3"]) -> Float[np.ndarray, "J 3"]:
    """Returns the T-pose: mean bone lengths, straight limbs, and the mean shapes of pelvis and chest."""
    bones = positions - positions[:, np.maximum(_PARENTS, 0)]
    offsets = np.zeros(bones.shape[1:])
    for name, direction in REST_DIRECTIONS.items():
        offsets[JOINT[name]] = direction
    for hub in (PELVIS, CHEST):
        # The mean of the bones in the hub's own frame.
        children = list(HUMANML3D.children(hub.joint))
        frames, is_sure = _hub_frames(hub, positions)
        offsets[children] = np.einsum("tab,tjb->ja", frames, bones[:, children]) / len(bones)
        if not is_sure:  # seen from the rotations that fit it best, the mean is the shape
            rotations = _hub_rotations(hub, offsets[children], bones[:, children], positions)
            offsets[children] = np.einsum("tba,tjb->ja", rotations, bones[:, children]) / len(bones)
    return unit_vectors(offsets) * np.linalg.norm(bones, axis=-1).mean(axis=0)[:, None]


def _hub_frames(hub: _Hub, positions: Float[np.ndarray, "T J 3"]) -> tuple[Float[np.ndarray, "T 3 3"], bool]:
    """Returns the axes of a hub as rows, X from right to left and Y upwards, and whether its own bones tell them."""
    bones = positions - positions[:, np.maximum(_PARENTS, 0)]
    lengths = np.linalg.norm(bones, axis=-1).mean(axis=0)
    is_sure = bool(lengths[hub.above] >= MIN_BONE * lengths[1:].mean())
    across = bones[:, hub.left] - bones[:, hub.right]
    up = bones[:, hub.above]
    if not is_sure:
        torso = torso_frames(positions, HUMANML3D)
        across = across + HINT * torso[:, 0]  # both may be at the hub, too
        up = torso[:, 1]
    across = unit_vectors(across)
    up = unit_vectors(up - np.sum(up * across, axis=-1, keepdims=True) * across)
    return np.stack((across, up, np.cross(across, up)), axis=-2), is_sure


def _hub_rotations(
    hub: _Hub,
    rest: Float[np.ndarray, "N 3"],
    targets: Float[np.ndarray, "T N 3"],
    positions: Float[np.ndarray, "T J 3"],
) -> Float[np.ndarray, "T 3 3"]:
    """Returns the rotations that bring the bones `rest` of a hub closest to `targets`."""
    frames, is_sure = _hub_frames(hub, positions)
    if not is_sure:
        # The other bones may be on a line, so the axes tell the turn about it. Where they are not, they tell more.
        rest = np.concatenate((rest, HINT * np.eye(3)))
        targets = np.concatenate((targets, HINT * frames), axis=1)
    return rigid_rotations(rest, targets)


def _rigid_positions(
    positions: Float[np.ndarray, "T J 3"], offsets: Float[np.ndarray, "J 3"]
) -> Float[np.ndarray, "T J 3"]:
    """Returns positions close to `positions` with the bone lengths and hub shapes of `offsets`.

    Each wrong distance repeatedly moves both of its joints by half of the error. Unlike a fit from the root outwards,
    this distributes the errors of a motion that no rigid figure can perform over all joints, including the root.
    """
    pairs = [(child, parent) for child, parent in enumerate(_PARENTS) if parent >= 0]
    pairs += [pair for hub in (PELVIS, CHEST) for pair in itertools.combinations(HUMANML3D.children(hub.joint), 2)]
    joints = np.moveaxis(positions, 1, 0).copy()
    for _ in range(RIGID_SWEEPS):
        for a, b in pairs:
            length = np.linalg.norm(offsets[a] - offsets[b] * (_PARENTS[a] != b))
            apart = joints[a] - joints[b]
            distance = np.linalg.norm(apart, axis=-1, keepdims=True)
            move = apart * ((length - distance) / np.maximum(distance, 1e-9) / 2)
            joints[a] += move
            joints[b] -= move
    return np.moveaxis(joints, 0, 1)
