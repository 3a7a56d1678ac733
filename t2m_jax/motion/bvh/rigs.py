"""Rigs: the joints of a BVH file that correspond to the 22 joints of HumanML3D."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

from t2m_jax.errors import UserError
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.yaml_file import load_yaml

# A rig may lack these joints. They are placed between their neighbors.
OPTIONAL_JOINTS = ("spine1", "spine2", "spine3", "left_collar", "right_collar", "head")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Rig:
    """A table from the joints of HumanML3D to the joints of another hierarchy."""

    name: str
    """Name on the command line."""
    sources: tuple[tuple[str, tuple[str, ...]], ...]
    """Joints of HumanML3D with their names in the rig. The first name that a file has is used."""


def _sided(**patterns: str) -> dict[str, str]:
    """Returns a table for both sides. In the patterns, {side} becomes Left or Right, {S} L or R, and {s} l or r."""
    return {
        f"{side.lower()}_{joint}": pattern.format(side=side, S=side[0], s=side[0].lower())
        for joint, pattern in patterns.items()
        for side in ("Left", "Right")
    }


def make_rig(table: Mapping[str, str | Sequence[str]], *, name: str) -> Rig:
    """Returns the rig described by a table such as `{"pelvis": "Hips", "left_foot": ["LeftToe", "LeftToeBase"]}`.

    Args:
        table: From joints of HumanML3D to a joint of the file, or to several spellings of it. The joints of
            `OPTIONAL_JOINTS` may be missing.
        name: Name for error messages. For a table from a file, its path.
    """
    unknown = [joint for joint in table if joint not in HUMANML3D.joint_names]
    if unknown:
        raise UserError(f'{name}: unknown joint "{unknown[0]}"; known are {", ".join(HUMANML3D.joint_names)}')
    missing = [joint for joint in HUMANML3D.joint_names if joint not in table and joint not in OPTIONAL_JOINTS]
    if missing:
        raise UserError(f"{name}: no joint is given for {', '.join(missing)}")
    sources = []
    for joint, names in table.items():
        sources.append((joint, (names,) if isinstance(names, str) else tuple(names)))
    return Rig(name=name, sources=tuple(sources))


def load_rig(path: Path | str) -> Rig:
    """Returns the rig of a YAML file with one line per joint, such as `pelvis: Hips`.

    Raises:
        UserError: The file cannot be read, or has no such lines.
    """
    table = load_yaml(path).data
    for joint, names in table.items():
        spellings = names if isinstance(names, list) else [names]
        if not isinstance(joint, str) or not spellings or not all(isinstance(one, str) for one in spellings):
            raise UserError(f"{path}: {joint} needs a joint name or a list of joint names")
    return make_rig(table, name=str(path))


BANDAI_NAMCO = make_rig(
    {"pelvis": "Hips", "spine3": "Chest", "neck": "Neck", "head": "Head"}
    | _sided(hip="UpperLeg_{S}", knee="LowerLeg_{S}", ankle="Foot_{S}", foot="Toes_{S}")
    | _sided(collar="Shoulder_{S}", shoulder="UpperArm_{S}", elbow="LowerArm_{S}", wrist="Hand_{S}"),
    name="bandai-namco",
)
CMU_ICLONE = make_rig(
    {"pelvis": "CC_Base_Hip", "spine1": "CC_Base_Spine01", "spine2": "CC_Base_Spine02"}
    | {"neck": "CC_Base_NeckTwist01", "head": "CC_Base_Head"}
    | _sided(hip="CC_Base_{S}_Thigh", knee="CC_Base_{S}_Calf", ankle="CC_Base_{S}_Foot", foot="CC_Base_{S}_ToeBase")
    | _sided(collar="CC_Base_{S}_Clavicle", shoulder="CC_Base_{S}_Upperarm")
    | _sided(elbow="CC_Base_{S}_Forearm", wrist="CC_Base_{S}_Hand"),
    name="cmu-iclone",
)
MIXAMO = make_rig(
    {"pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head"}
    | _sided(hip="{side}UpLeg", knee="{side}Leg", ankle="{side}Foot")
    | _sided(collar="{side}Shoulder", shoulder="{side}Arm", elbow="{side}ForeArm", wrist="{side}Hand")
    | {"left_foot": ("LeftToe", "LeftToeBase"), "right_foot": ("RightToe", "RightToeBase")},
    name="mixamo",
)
DAZ = make_rig(
    {"pelvis": "hip", "spine1": "abdomen", "spine3": "chest", "neck": "neck", "head": "head"}
    | _sided(hip="{s}Thigh", knee="{s}Shin", ankle="{s}Foot", foot="{s}Foot End Site")
    | _sided(collar="{s}Collar", shoulder="{s}Shldr", elbow="{s}ForeArm", wrist="{s}Hand"),
    name="daz",
)
RIGIFY = make_rig(
    {"pelvis": "DEF-hips", "spine1": "DEF-spine.001", "spine2": "DEF-spine.002", "spine3": "DEF-spine.003"}
    | {"neck": "DEF-neck", "head": "DEF-head"}
    | _sided(hip="DEF-thigh.{S}", knee="DEF-shin.{S}", ankle="DEF-foot.{S}", foot="DEF-toe.{S}")
    | _sided(collar="DEF-shoulder.{S}", shoulder="DEF-upper_arm.{S}", elbow="DEF-forearm.{S}", wrist="DEF-hand.{S}"),
    name="rigify",
)
# Its joint `head` is at the base of the neck.
KAYKIT = make_rig(
    {"pelvis": "hips", "spine1": "spine", "spine3": "chest", "neck": "head"}
    | _sided(hip="upperleg.{s}", knee="lowerleg.{s}", ankle="foot.{s}", foot="toes.{s}")
    | _sided(shoulder="upperarm.{s}", elbow="lowerarm.{s}", wrist="wrist.{s}"),
    name="kaykit",
)
RIGS = {rig.name: rig for rig in (BANDAI_NAMCO, CMU_ICLONE, MIXAMO, DAZ, RIGIFY, KAYKIT)}


def match_rig(rig: Rig, joint_names: Sequence[str]) -> dict[str, int]:
    """Returns the index in `joint_names` of each HumanML3D joint.

    Names match with or without a namespace (`mixamorig:Hips`). Joints that the hierarchy does not have are left out.
    """
    index: dict[str, int] = {}
    for i, name in enumerate(joint_names):
        index.setdefault(name, i)
        index.setdefault(name.rpartition(":")[2], i)
    found = {}
    for joint, spellings in rig.sources:
        hits = [index[spelling] for spelling in spellings if spelling in index]
        if hits:
            found[joint] = hits[0]
    return found


def detect_rig(joint_names: Sequence[str]) -> Rig:
    """Returns the named rig whose joints are all in `joint_names`."""
    complete = [rig for rig in RIGS.values() if len(match_rig(rig, joint_names)) == len(rig.sources)]
    if not complete:
        shown = ", ".join(joint_names[:6])
        raise UserError(
            f"no known rig ({', '.join(RIGS)}) has the joints {shown}, …; give a table such as `pelvis: Hips`, "
            "one line for each of the 22 joints"
        )
    return complete[0]
