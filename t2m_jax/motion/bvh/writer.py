"""Writing motions of the 22 joints as BVH files with a T-pose as rest pose, as animation programs expect."""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.files.writing import save_text
from t2m_jax.motion.cleanup import CONTACT_HEIGHT
from t2m_jax.motion.features import bone_vectors
from t2m_jax.motion.inverse_kinematics import FittedRig, fit_rig
from t2m_jax.motion.kinematics import forward_kinematics
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.part_captions import parts_note
from t2m_jax.motion.rig.rigs import JointNames, rig_joint_names, root_name
from t2m_jax.motion.rotations import (
    EulerOrder,
    euler_from_matrix,
    matrix_from_quaternion,
    quaternion_from_matrix,
    unit_vectors,
)
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.motion.travel import Travel, find_travel

logger = logging.getLogger(__name__)

Units = Literal["m", "cm"]
UNITS_PER_METER: dict[Units, float] = {"m": 1.0, "cm": 100.0}

# Many readers expect one order for all joints. Y turns first, so that figures can face any direction, and elbows can
# bend to any angle, without gimbal lock.
_ORDER: EulerOrder = "ZXY"
_ROTATIONS = " ".join(f"{axis}rotation" for axis in _ORDER)
_MOVING = f"6 Xposition Yposition Zposition {_ROTATIONS}"
_LOCKED_COSINE = 1e-4
FAR = 0.02
"""Meters between a joint and where the motion has it from which it is said: bones of a BVH file have one length."""
# Length of each End Site relative to the last bone, up to the crown, the finger tips and the tip of the shoe.
END_SITES = {"head": 1.7, "left_wrist": 0.65, "right_wrist": 0.65, "left_foot": 0.35, "right_foot": 0.35}
FLAT_SHARE = 0.25
"""Quantile of the slopes of feet whose toes are low that is taken as that of a flat foot: in others, the heel is up."""
STEEPEST = 0.7
"""No foot that is flat goes down more steeply from ankle to toe; sine."""


def save_bvh(
    path: Path | str, motion: Motion, *, names: JointNames = "lafan1", units: Units = "m", root_bone: bool = False
) -> None:
    """Writes `motion` as a BVH file, Y up.

    The OFFSETs are the rest pose, a T-pose. The OFFSET of the hips is zero, so that their position channels mean the
    same in programs that add them to OFFSET and in programs that do not. If a motion has several sentences, the line of
    the first End Site says where each begins: BVH has no comments, but the programs that were tried ignore text there.

    Args:
        path: The file.
        motion: A motion of the 22 HumanML3D joints.
        names: What the joints are called: as in the rig of that name.
        units: Length of 1 in the file.
        root_bone: Whether a joint on the floor carries the travel (see `find_travel`), and the hips only their sway.
    """
    if motion.skeleton.joint_names != HUMANML3D.joint_names:
        raise UserError(f"{path}: BVH files are written for the skeleton {HUMANML3D.name}, not {motion.skeleton.name}")
    if motion.fps < 1:
        raise UserError(f"{path}: {motion.fps:g} frames a second are too few for a BVH file; give it 1 or more")
    rig = fit_rig(motion.positions, fps=motion.fps)
    _tell_distance(path, motion, rig)
    scale = UNITS_PER_METER[units]
    ends = scale * end_sites(rig.offsets, flat_slope(motion.positions))
    joints = _hierarchy_lines(scale * rig.offsets, ends, rig_joint_names(names), depth=int(root_bone))
    columns = []
    if root_bone:
        travel = find_travel(motion.positions, fps=motion.fps, skeleton=HUMANML3D)
        joints = [f"ROOT {root_name(names)}", "{", "  OFFSET 0 0 0", f"  CHANNELS {_MOVING}", *joints, "}"]
        columns = [scale * travel.places, _degrees(matrix_from_quaternion(travel.turns[:, None]))]
        rig = _seen_from(travel, rig)
    table = np.concatenate([*columns, scale * rig.root_positions, _degrees(rig.rotations[:, _depth_first(0)])], axis=1)
    lines = ["HIERARCHY", *joints]
    if motion.part_starts:
        first = next(number for number, line in enumerate(lines) if line.endswith("End Site"))
        parts = tuple(zip(motion.part_starts, motion.part_captions, strict=True))
        lines[first] += " " + parts_note(parts, fps=motion.fps)
    lines += ["MOTION", f"Frames: {len(table)}", f"Frame Time: {1 / motion.fps:.9f}", *map(_numbers, table)]
    save_text(path, "\n".join(lines) + "\n")


def _tell_distance(path: Path | str, motion: Motion, rig: FittedRig) -> None:
    """Says how far joints of the file are from those of a motion whose bones change their lengths."""
    written = forward_kinematics(rig.rotations, rig.translations, HUMANML3D.parents).positions
    far = np.linalg.norm(written - motion.positions, axis=-1).max(axis=0)
    if far.max() > FAR:
        name = HUMANML3D.joint_names[int(far.argmax())]
        logger.info(
            "%s: joints are up to %.0f mm away from the motion (%s), whose bones change their lengths; a .glb file "
            "shows them",
            path,
            1000 * far.max(),
            name,
        )


def _seen_from(travel: Travel, rig: FittedRig) -> FittedRig:
    """Returns a rig below a root bone."""
    rotations = rig.rotations.copy()
    rotations[:, 0] = matrix_from_quaternion(travel.local_turns(quaternion_from_matrix(rotations[:, 0])))
    return rig._replace(rotations=rotations, root_positions=travel.local_places(rig.root_positions))


def _degrees(matrices: Float[np.ndarray, "T J 3 3"]) -> Float[np.ndarray, "T C"]:
    """Returns the values of the rotation channels of joints."""
    return np.rad2deg(continuous_euler(matrices)).reshape(len(matrices), -1)


def continuous_euler(matrices: Float[np.ndarray, "T J 3 3"]) -> Float[np.ndarray, "T J 3"]:
    """Returns Euler angles in radians, in the writer's order, that do not jump between frames.

    Two triples of angles, and those with full turns added, give the same rotation. Each frame gets the triple that is
    nearest to the frame before. If the middle angle is ±90°, only a sum of the others is determined (gimbal lock), and
    both get half of its change.
    """
    principal = euler_from_matrix(matrices, _ORDER).astype(np.float64)
    result = np.empty_like(principal)
    previous = np.zeros(principal.shape[1:])  # the rest pose, to which the first frame is as near as possible
    for frame, angles in enumerate(principal):
        mirrored = angles * (1, -1, 1) + np.pi
        candidates = previous + _wrapped(np.stack((angles, mirrored)) - previous)
        nearer = np.abs(candidates - previous).sum(axis=-1).argmin(axis=0)
        chosen = candidates[nearer, np.arange(len(nearer))]
        locked = np.abs(np.cos(chosen[:, 1])) < _LOCKED_COSINE
        steps = chosen[locked] - previous[locked]
        sign = np.sign(np.sin(chosen[locked, 1]))
        change = _wrapped(steps[:, 0] + sign * steps[:, 2])
        chosen[locked, 0] = previous[locked, 0] + change / 2
        chosen[locked, 2] = previous[locked, 2] + sign * change / 2
        result[frame] = previous = chosen
    return result


def _wrapped(angles: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    """Returns the same angles between -pi and pi."""
    return (angles + np.pi) % (2 * np.pi) - np.pi


def _depth_first(joint: int) -> list[int]:
    """Returns `joint` and its descendants in the order of the file."""
    return [joint] + [below for child in HUMANML3D.children(joint) for below in _depth_first(child)]


def flat_slope(positions: Float[np.ndarray, "T J 3"]) -> float:
    """Returns how steeply a flat foot goes down from the ankle to the toe: the sine of the angle."""
    toes = [HUMANML3D.left_foot[1], HUMANML3D.right_foot[1]]
    heights = positions[:, toes, 1]
    slopes = -unit_vectors(bone_vectors(positions, HUMANML3D)[:, np.array(toes) - 1])[..., 1]
    flat = np.quantile(slopes[heights <= heights.min() + CONTACT_HEIGHT], FLAT_SHARE, method="lower")
    return float(np.clip(flat, 0.0, STEEPEST))


def end_sites(offsets: Float[np.ndarray, "J 3"], slope: float) -> Float[np.ndarray, "J 3"]:
    """Returns the place of the End Site of each joint without children in its frame; zero for the others.

    Feet are level in the rest pose. When they stand, the bone to the toe goes down, and so the tip of the shoe, which
    is as high as the toe then, is above the line of the bone.
    """
    ends = offsets * np.array([[END_SITES.get(name, 0.0)] for name in HUMANML3D.joint_names])
    for toe in (HUMANML3D.left_foot[1], HUMANML3D.right_foot[1]):
        upward = np.array([0.0, slope * np.linalg.norm(ends[toe]), 0.0])
        ends[toe] = np.sqrt(1 - slope**2) * ends[toe] + upward
    return ends


def _hierarchy_lines(
    offsets: Float[np.ndarray, "J 3"],
    ends: Float[np.ndarray, "J 3"],
    names: Sequence[str],
    joint: int = 0,
    depth: int = 0,
) -> list[str]:
    """Returns the lines of `joint` and its descendants."""
    role = HUMANML3D.joint_names[joint]
    pad = "  " * depth
    inner = pad + "  "
    channels = f"3 {_ROTATIONS}" if joint else _MOVING
    lines = [f"{pad}{'JOINT' if depth else 'ROOT'} {names[joint]}", pad + "{"]
    lines += [f"{inner}OFFSET {_numbers(offsets[joint])}", f"{inner}CHANNELS {channels}"]
    for child in HUMANML3D.children(joint):
        lines += _hierarchy_lines(offsets, ends, names, child, depth + 1)
    if role in END_SITES:
        lines += [inner + "End Site", inner + "{", f"{inner}  OFFSET {_numbers(ends[joint])}", inner + "}"]
    return [*lines, pad + "}"]


def _numbers(values: Float[np.ndarray, " N"]) -> str:
    """Returns `values` with six decimals. Adding zero turns -0 into 0."""
    return " ".join(f"{value:.6f}" for value in np.round(np.asarray(values, np.float64), 6) + 0.0)
