"""Motion in the parameters of the body model SMPL: rotations of its joints, and the place of its pelvis.

The body model itself, whose license is not open, is not needed: only where its joints are in the rest pose.
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.character import ENDS
from t2m_jax.motion.inverse_kinematics import fit_rig
from t2m_jax.motion.kinematics import rest_positions, rigid_rotations
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rig.transfer import transfer
from t2m_jax.motion.rotations import (
    quaternion_inverse,
    quaternion_multiply,
    rotate_vectors,
    unit_vectors,
)
from t2m_jax.motion.skeleton import HUMANML3D, JOINT

NUM_JOINTS = 52
"""Joints of SMPL+H, as in AMASS: the 22 of HumanML3D in the same order, and those of the hands."""
PELVIS = (0.0, -0.223, 0.028)
"""Place of the pelvis in the rest pose, to which the translation is added; meters."""
SOLE = 0.02
"""Height of the balls of the feet above the floor."""
ALIKE = np.cos(np.deg2rad(15.0))
"""Bones from the pelvis to the hips, and from the chest to the collars, are as SMPL's if they are so near to them."""
FLOOR = (-0.02, 0.1)
"""Heights of the lowest joint of who is on the floor, in meters."""
STANDS = 0.8
"""Figures in a file with Y up are this much along Y on average (cosine). AMASS has Z up."""
_SPINE = {
    "spine1": (0.0, 0.109, -0.027),
    "spine2": (0.0, 0.135, 0.001),
    "spine3": (0.0, 0.053, 0.025),
    "neck": (0.0, 0.214, -0.043),
    "head": (0.0, 0.065, 0.051),
}
_SIDE = {
    "hip": (0.069, -0.091, -0.006),
    "knee": (0.036, -0.379, -0.007),
    "ankle": (-0.015, -0.398, -0.043),
    "foot": (0.026, -0.052, 0.121),
    "collar": (0.080, 0.120, -0.036),
    "shoulder": (0.094, 0.032, -0.009),
    "elbow": (0.257, -0.013, -0.024),
    "wrist": (0.252, 0.008, -0.003),
}


def _offset(name: str) -> tuple[float, float, float]:
    side, _, role = name.rpartition("_")
    x, y, z = _SIDE[role] if side else _SPINE.get(role, (0.0, 0.0, 0.0))
    return (-x if side == "right" else x), y, z


OFFSETS = np.array([_offset(name) for name in HUMANML3D.joint_names], np.float32)
"""Vectors from the parent to each joint of the mean body, to whose left +X is; meters.

Physics simulations of SMPL's skeleton publish them. These are the means of both sides.
"""
_TO_Z_UP = np.array([1.0, 1.0, 0.0, 0.0]) / np.sqrt(2)


class SmplPoses(NamedTuple):
    """A motion of SMPL's mean body, as AMASS has it: Z up, the floor at z = 0."""

    poses: Float[np.ndarray, "T 156"]
    """Rotation of each joint in its parent's frame, as axis times angle in radians; those of hands are zero."""
    trans: Float[np.ndarray, "T 3"]
    """What is added to the places of the rest pose; meters."""


def smpl_from_motion(motion: Motion) -> SmplPoses:
    """Returns how SMPL's mean body moves as a motion of the 22 joints does.

    Limbs have the directions of the motion. As on any character (see `transfer`), hips and feet travel as far as the
    body's legs are long, feet are on the floor, and hands, toes and head keep their rest pose.
    """
    from scipy.spatial.transform import Rotation  # here, because it takes long to import

    rest = rest_positions(OFFSETS, HUMANML3D.parents).astype(np.float64)
    rest[:, 1] += SOLE - rest[:, 1].min()
    movement = transfer(motion, rest, HUMANML3D.joint_names, same_joints=_has_joints_of_smpl(motion))
    local = movement.turns.copy()
    local[:, 0] = quaternion_multiply(_TO_Z_UP, movement.turns[:, 0])
    above = movement.turns[:, HUMANML3D.parents[1:]]
    local[:, 1:] = quaternion_multiply(quaternion_inverse(above), movement.turns[:, 1:])
    local[:, [JOINT[name] for name in ENDS]] = (1.0, 0.0, 0.0, 0.0)
    poses = np.zeros((motion.num_frames, NUM_JOINTS, 3))
    rotations = Rotation.from_quat(local.reshape(-1, 4)[:, [1, 2, 3, 0]])
    poses[:, : HUMANML3D.num_joints] = rotations.as_rotvec().reshape(*local.shape[:2], 3)
    trans = rotate_vectors(_TO_Z_UP, movement.pelvis) - np.array(PELVIS)
    return SmplPoses(poses.reshape(len(poses), -1), trans)


def _has_joints_of_smpl(motion: Motion) -> bool:
    """Returns whether hips and collars are where SMPL has them, as in HumanML3D and in what is learned from it."""
    own = fit_rig(motion.positions, fps=motion.fps).offsets
    for name in ("pelvis", "spine3"):
        children = list(HUMANML3D.children(JOINT[name]))
        bones, wanted = unit_vectors(own[children]), unit_vectors(OFFSETS[children])
        turned = wanted @ rigid_rotations(wanted, bones).T
        if not (np.sum(turned * bones, axis=-1) > ALIKE).all():
            return False
    return True


def clip_from_smpl(
    poses: Float[np.ndarray, "T C"], trans: Float[np.ndarray, "T 3"], *, fps: float, notes: tuple[str, ...] = ()
) -> RigClip:
    """Returns the 22 joints of SMPL's mean body.

    Args:
        poses: As `SmplPoses.poses`, of which the first 22 joints are read.
        trans: As `SmplPoses.trans`.
        fps: Frames per second.
        notes: What had to be assumed.
    """
    from scipy.spatial.transform import Rotation  # here, because it takes long to import

    joints = HUMANML3D.num_joints
    rotations = Rotation.from_rotvec(poses[:, : 3 * joints].reshape(-1, 3)).as_matrix()
    translations = np.tile(OFFSETS, (len(poses), 1, 1))
    translations[:, 0] = trans + np.array(PELVIS)
    return RigClip(
        joint_names=HUMANML3D.joint_names,
        parents=HUMANML3D.parents,
        offsets=OFFSETS,
        rotations=rotations.reshape(-1, joints, 3, 3).astype(np.float32),
        translations=translations,
        fps=fps,
        metres_per_unit=1.0,
        is_person=True,
        notes=notes,
    )


def up_of_smpl(clip: RigClip) -> Literal["y", "z"]:
    """Returns the axis that points up. The rest pose does not tell: it is along Y in both cases.

    Who lies or crawls along Y has a body along Y, too, but then it is on the floor along Z.
    """
    positions = clip.positions
    ankles = positions[:, [JOINT["left_ankle"], JOINT["right_ankle"]]].mean(axis=1)
    upward = unit_vectors(positions[:, JOINT["neck"]] - ankles).mean(axis=0)
    lowest = np.median(positions.min(axis=1), axis=0)
    _, y_has_floor, z_has_floor = (FLOOR[0] < lowest) & (lowest < FLOOR[1])
    return "y" if upward[1] > STANDS and (y_has_floor or not z_has_floor) else "z"
