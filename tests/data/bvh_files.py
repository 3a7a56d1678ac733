"""Small BVH files in the layout of the Bandai-Namco archive, made here since the archive may not be passed on."""

from pathlib import Path

import numpy as np

_LIMBS = {
    "Shoulder_{S}": "Chest",
    "UpperArm_{S}": "Shoulder_{S}",
    "LowerArm_{S}": "UpperArm_{S}",
    "Hand_{S}": "LowerArm_{S}",
    "UpperLeg_{S}": "Hips",
    "LowerLeg_{S}": "UpperLeg_{S}",
    "Foot_{S}": "LowerLeg_{S}",
    "Toes_{S}": "Foot_{S}",
}
PARENTS = {"Hips": "joint_Root", "Spine": "Hips", "Chest": "Spine", "Neck": "Chest", "Head": "Neck"} | {
    joint.format(S=side): parent.format(S=side) for side in "LR" for joint, parent in _LIMBS.items()
}
_CHANNELS = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"


def _offset(joint: str) -> tuple[float, float, float]:
    """Returns the offset of a joint in centimetres, in a T-pose."""
    name, _, side = joint.partition("_")
    sign = {"L": 1.0, "R": -1.0}.get(side, 0.0)
    fixed = {
        "Hips": (0.0, 90.0, 0.0),
        "Spine": (0.0, 16.0, 0.0),
        "Chest": (0.0, 9.0, 0.0),
        "Neck": (0.0, 16.0, 0.0),
        "Head": (0.0, 6.0, 3.0),
        "UpperLeg": (7.0 * sign, -2.0, 0.0),
        "LowerLeg": (0.0, -39.0, 0.0),
        "Foot": (0.0, -41.0, 0.0),
        "Toes": (0.0, -4.0, 11.0),
        "Shoulder": (4.0 * sign, 8.0, 0.0),
    }
    return fixed.get(name, (20.0 * sign, 0.0, 0.0))


def _hierarchy(joint: str, indent: str = "") -> list[str]:
    children = [child for child, parent in PARENTS.items() if parent == joint]
    offset = " ".join(map(str, _offset(joint) if joint in PARENTS else (0.0, 0.0, 0.0)))
    lines = [f"{indent}{'JOINT' if joint in PARENTS else 'ROOT'} {joint}", f"{indent}{{"]
    lines += [f"{indent}  OFFSET {offset}", f"{indent}  {_CHANNELS}"]
    for child in children:
        lines += _hierarchy(child, indent + "  ")
    if not children:
        lines += [f"{indent}  End Site", f"{indent}  {{", f"{indent}    OFFSET 0 0 0", f"{indent}  }}"]
    return [*lines, f"{indent}}}"]


def _order(joint: str) -> list[str]:
    return [joint, *(name for child, parent in PARENTS.items() if parent == joint for name in _order(child))]


def write_bvh(path: Path, *, num_frames: int = 45, speed: float = 120.0, seed: int = 0) -> Path:
    """Writes a figure that glides ahead at `speed` cm/s with swinging limbs, 30 frames a second."""
    generator = np.random.default_rng(seed)
    names = _order("joint_Root")
    phases = dict(zip(names, generator.uniform(0, 6, len(names)), strict=True))
    rows = []
    for frame in range(num_frames):
        row: list[float] = []
        for name in names:
            x, y, z = _offset(name) if name in PARENTS else (0.0, 0.0, 0.0)
            z += speed * frame / 30 if name == "Hips" else 0.0
            angle = 8 * np.sin(0.2 * frame + phases[name]) if name in PARENTS and name != "Hips" else 0.0
            row += [x, y, z, 0.0, angle, 0.0]
        rows.append(" ".join(f"{value:.6g}" for value in row))
    motion = ["MOTION", f"Frames:\t{num_frames}", "Frame Time:\t0.0333333", *rows]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(["HIERARCHY", *_hierarchy("joint_Root"), *motion]) + "\n", encoding="utf-8")
    return path
