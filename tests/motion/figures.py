"""Small BVH texts and moving figures that several test files share."""

import numpy as np

from t2m_jax.motion.kinematics import forward_kinematics
from t2m_jax.motion.rotations import matrix_from_euler
from t2m_jax.motion.skeleton import HUMANML3D

INDEX = {name: i for i, name in enumerate(HUMANML3D.joint_names)}

ARM_BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 90 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Arm
  {
    OFFSET 30 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT Hand
    {
      OFFSET 40 0 0
      CHANNELS 3 Zrotation Xrotation Yrotation
      End Site
      {
        OFFSET 10 0 0
      }
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0 0 0 0 0 0 0 0 0 0 0 0
1 2 3 0 0 90 90 0 0 0 0 0
"""


def bvh_text(
    joints: dict[str, tuple[str | None, tuple[float, float, float]]],
    frames: np.ndarray,
    *,
    root_channels: str = "Xposition Yposition Zposition Zrotation Xrotation Yrotation",
    channels: str = "Zrotation Xrotation Yrotation",
    frame_time: str = "0.05",
) -> str:
    """Returns a BVH file; `joints` are listed depth first as name: (parent, offset)."""

    def block(name: str, keyword: str) -> list[str]:
        names = root_channels if keyword == "ROOT" else channels
        lines = [f"{keyword} {name}", "{", "OFFSET " + " ".join(map(str, joints[name][1]))]
        lines.append(f"CHANNELS {len(names.split())} {names}")
        children = [child for child, (parent, _) in joints.items() if parent == name]
        for child in children:
            lines += block(child, "JOINT")
        if not children:
            lines += ["End Site", "{", "OFFSET 0 0 0", "}"]
        return [*lines, "}"]

    root = next(name for name, (parent, _) in joints.items() if parent is None)
    rows = [" ".join(f"{value:.6f}" for value in row) for row in frames]
    head = ["HIERARCHY", *block(root, "ROOT"), "MOTION", f"Frames: {len(frames)}", f"Frame Time: {frame_time}"]
    return "\n".join(head + rows) + "\n"


def standing_offsets() -> np.ndarray:
    """Returns the bones of a person standing with hanging arms, `[22, 3]` metres."""
    offsets = HUMANML3D.offsets.astype(np.float64)
    directions = {
        "left_hip": (0.6, -0.8, 0.0),
        "left_foot": (0.1, -0.4, 0.9),
        "spine1": (0.0, 1.0, -0.1),
        "left_collar": (0.5, 0.85, -0.1),
        "left_shoulder": (0.95, -0.2, -0.2),
        "left_elbow": (0.15, -1.0, 0.0),
        "left_wrist": (0.1, -1.0, 0.1),
        "head": (0.0, 0.9, 0.4),
    }
    for name, direction in directions.items():
        for side, sign in (("left", 1), ("right", -1)):
            joint = INDEX[name.replace("left", side)]
            vector = np.array(direction) * (sign if "left" in name else 1, 1, 1)
            offsets[joint] = vector / np.linalg.norm(vector) * HUMANML3D.bone_lengths[joint]
    return offsets


def walking_positions(num_frames: int = 60, fps: float = 20.0) -> np.ndarray:
    """Returns a walk with swinging limbs and a slow turn, `[T, 22, 3]` float32 metres."""
    time = np.arange(num_frames) / fps
    swing = np.sin(2 * np.pi * time)
    angles = np.zeros((num_frames, 22, 3))  # about X, Y, Z
    angles[:, INDEX["pelvis"], 1] = 0.5 * time
    angles[:, INDEX["spine2"], 0] = 0.1 + 0.05 * swing
    angles[:, INDEX["spine3"], 1] = -0.2 * swing
    for side, sign in (("left", 1), ("right", -1)):
        angles[:, INDEX[f"{side}_hip"], 0] = -0.5 * sign * swing
        angles[:, INDEX[f"{side}_knee"], 0] = 0.5 + 0.4 * sign * np.cos(2 * np.pi * time)
        angles[:, INDEX[f"{side}_ankle"], 0] = -0.2 * sign * swing
        angles[:, INDEX[f"{side}_shoulder"], 0] = 0.6 * sign * swing
        angles[:, INDEX[f"{side}_elbow"], 0] = -0.7 + 0.5 * sign * swing
    translations = np.repeat(standing_offsets()[None], num_frames, axis=0)
    translations[:, 0] = np.stack((0.2 * time, 0.92 + 0.02 * np.cos(4 * np.pi * time), 1.2 * time), axis=-1)
    return forward_kinematics(matrix_from_euler(angles, "XYZ"), translations, HUMANML3D.parents).positions


def turn_angles(matrices: np.ndarray) -> np.ndarray:
    """Returns by how many degrees each rotation differs from that of the next frame, `[T-1, ...]`."""
    steps = np.swapaxes(matrices[:-1], -1, -2).astype(np.float64) @ matrices[1:]
    # The chord, since arccos of the trace loses all digits at small angles.
    chord = np.linalg.norm(steps - np.eye(3), axis=(-2, -1)) / np.sqrt(8)
    return np.rad2deg(2 * np.arcsin(np.clip(chord, 0, 1)))
