"""Writing motions of the 22 joints as BVH files that animation programs open with a T-pose at rest."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.files import save_text
from t2m_jax.motion.bvh.inverse_kinematics import fit_rig
from t2m_jax.motion.bvh.kinematics import forward_kinematics
from t2m_jax.motion.record import Motion
from t2m_jax.motion.rotations import EulerOrder, euler_from_matrix
from t2m_jax.motion.skeleton import HUMANML3D

# fmt: off
BVH_JOINT_NAMES = (
    "Hips", "LeftUpLeg", "RightUpLeg", "Spine", "LeftLeg", "RightLeg", "Spine1", "LeftFoot", "RightFoot", "Spine2",
    "LeftToe", "RightToe", "Neck", "LeftShoulder", "RightShoulder", "Head", "LeftArm", "RightArm", "LeftForeArm",
    "RightForeArm", "LeftHand", "RightHand",
)
# fmt: on
"""The names in the file, in the order of HumanML3D's joints."""

# One order for all joints, as many readers assume. Turning about Y comes first of all, so that a figure may face
# anywhere and elbows may bend to any angle without gimbal lock.
_ORDER: EulerOrder = "ZXY"
_LOCKED_COSINE = 1e-4
# End Sites lengthen the last bone of a limb: to the crown, the finger tips and the tip of the shoe.
_END_SITES = {"Head": 1.7, "LeftHand": 0.65, "RightHand": 0.65, "LeftToe": 0.35, "RightToe": 0.35}


def save_bvh(path: Path | str, motion: Motion, *, tpose_frame: bool = False) -> None:
    """Writes `motion` as a BVH file in metres, Y up.

    The OFFSETs are the rest pose, a T-pose. The root has OFFSET zero, so its position channels mean the same to
    readers that add them to OFFSET and to those that do not.

    Args:
        path: The file to write.
        motion: A motion of the 22 HumanML3D joints.
        tpose_frame: Whether to put one frame in T-pose, standing on the floor, before the motion.
    """
    if motion.skeleton.joint_names != HUMANML3D.joint_names:
        raise UserError(f"{path}: BVH files are written for the skeleton {HUMANML3D.name}, not {motion.skeleton.name}")
    rig = fit_rig(motion.positions, fps=motion.fps)
    roots = rig.root_positions
    degrees = np.rad2deg(continuous_euler(rig.rotations))
    if tpose_frame:
        rest = forward_kinematics(np.tile(np.eye(3), (len(rig.offsets), 1, 1)), rig.offsets, HUMANML3D.parents)
        stand = np.array([roots[0, 0], -rest.positions[:, 1].min(), roots[0, 2]])
        roots = np.concatenate((stand[None], roots))
        degrees = np.concatenate((np.zeros_like(degrees[:1]), degrees))
    order = _depth_first(0)
    table = np.concatenate((roots, degrees[:, order].reshape(len(degrees), -1)), axis=1)
    lines = ["HIERARCHY", *_hierarchy_lines(rig.offsets), *_motion_lines(table, motion.fps)]
    save_text(path, "\n".join(lines) + "\n")


def continuous_euler(matrices: Float[np.ndarray, "T J 3 3"]) -> Float[np.ndarray, "T J 3"]:
    """Returns Euler angles in radians, in the writer's order, that do not jump between frames.

    Of the two triples that make a rotation, and their full turns, each frame takes the one nearest to the frame
    before. Where the middle angle is at ±90° only a sum of the others is determined; they share its change.
    """
    principal = euler_from_matrix(matrices, _ORDER).astype(np.float64)
    result = np.empty_like(principal)
    previous = np.zeros(principal.shape[1:])
    for frame, angles in enumerate(principal):
        mirrored = angles * (1, -1, 1) + np.pi
        candidates = previous + _wrapped(np.stack((angles, mirrored)) - previous)
        nearer = np.abs(candidates - previous).sum(axis=-1).argmin(axis=0)
        chosen = candidates[nearer, np.arange(len(nearer))]
        locked = np.abs(np.cos(chosen[:, 1])) < _LOCKED_COSINE
        chosen[locked] = _shared_change(chosen[locked], previous[locked])
        result[frame] = previous = chosen
    return result


def _wrapped(angles: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    """Returns the same angles within ±pi."""
    return (angles + np.pi) % (2 * np.pi) - np.pi


def _shared_change(angles: Float[np.ndarray, "N 3"], previous: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    """Returns angles in gimbal lock with the change of their determined sum shared by first and last."""
    sign = np.sign(np.sin(angles[:, 1]))
    change = _wrapped((angles - previous)[:, 0] + sign * (angles - previous)[:, 2])
    return np.stack((previous[:, 0] + change / 2, angles[:, 1], previous[:, 2] + sign * change / 2), axis=-1)


def _children(joint: int) -> list[int]:
    return [child for child, parent in enumerate(HUMANML3D.parents) if parent == joint]


def _depth_first(joint: int) -> list[int]:
    """Returns `joint` and all below it in the order in which the file lists them."""
    return [joint] + [below for child in _children(joint) for below in _depth_first(child)]


def _hierarchy_lines(offsets: Float[np.ndarray, "J 3"], joint: int = 0, depth: int = 0) -> list[str]:
    """Returns the lines of `joint` and all below it."""
    name, pad, inner = BVH_JOINT_NAMES[joint], "  " * depth, "  " * (depth + 1)
    rotations = " ".join(f"{axis}rotation" for axis in _ORDER)
    channels = f"3 {rotations}" if depth else f"6 Xposition Yposition Zposition {rotations}"
    lines = [f"{pad}{'JOINT' if depth else 'ROOT'} {name}", pad + "{"]
    lines += [f"{inner}OFFSET {_numbers(offsets[joint])}", f"{inner}CHANNELS {channels}"]
    for child in _children(joint):
        lines += _hierarchy_lines(offsets, child, depth + 1)
    if name in _END_SITES:
        end = _numbers(offsets[joint] * _END_SITES[name])
        lines += [inner + "End Site", inner + "{", f"{inner}  OFFSET {end}", inner + "}"]
    return [*lines, pad + "}"]


def _motion_lines(table: Float[np.ndarray, "T C"], fps: float) -> list[str]:
    return ["MOTION", f"Frames: {len(table)}", f"Frame Time: {1 / fps:.9f}", *(_numbers(row) for row in table)]


def _numbers(values: Float[np.ndarray, " N"]) -> str:
    """Returns `values` with six digits behind the point; adding zero turns -0 into 0."""
    return " ".join(f"{value:.6f}" for value in np.round(np.asarray(values, np.float64), 6) + 0.0)
