"""The rigs that are known by name.

Those that were not tried on real files are made from the documentation of their makers.
"""

from collections.abc import Sequence
from typing import Literal

from t2m_jax.errors import UserError
from t2m_jax.motion.rig.rigs import Rig, make_rig, match_rig
from t2m_jax.motion.skeleton import HUMANML3D


def _sided(**patterns: str) -> dict[str, str]:
    """Returns a table for both sides.

    In the patterns, {side} becomes Left or Right, {low} left or right, {S} L or R, and {s} l or r.
    """
    return {
        f"{side.lower()}_{joint}": pattern.format(side=side, low=side.lower(), S=side[0], s=side[0].lower())
        for joint, pattern in patterns.items()
        for side in ("Left", "Right")
    }


JointNames = Literal["lafan1", "humanml3d", "mixamo", "vrm", "unreal"]
"""Rigs whose names for all 22 joints can be written."""

_MIXAMO_ARMS = _sided(
    collar="{side}Shoulder", shoulder="{side}Arm", elbow="{side}ForeArm", wrist="{side}Hand", knee="{side}Leg"
) | _sided(hip="{side}UpLeg", ankle="{side}Foot")
_XSENS = (
    {"pelvis": "Hips", "spine1": "Chest", "spine2": "Chest3", "spine3": "Chest4", "neck": "Neck", "head": "Head"}
    | _sided(hip="{side}Hip", knee="{side}Knee", ankle="{side}Ankle", foot="{side}Toe")
    | _sided(collar="{side}Collar", shoulder="{side}Shoulder", elbow="{side}Elbow", wrist="{side}Wrist")
)

_TRIED = {
    "humanml3d": {joint: joint for joint in HUMANML3D.joint_names},
    "bandai-namco": {"pelvis": "Hips", "spine3": "Chest", "neck": "Neck", "head": "Head"}
    | _sided(hip="UpperLeg_{S}", knee="LowerLeg_{S}", ankle="Foot_{S}", foot="Toes_{S}")
    | _sided(collar="Shoulder_{S}", shoulder="UpperArm_{S}", elbow="LowerArm_{S}", wrist="Hand_{S}"),
    "cmu-iclone": {"pelvis": "CC_Base_Hip", "spine1": "CC_Base_Spine01", "spine2": "CC_Base_Spine02"}
    | {"neck": "CC_Base_NeckTwist01", "head": "CC_Base_Head"}
    | _sided(hip="CC_Base_{S}_Thigh", knee="CC_Base_{S}_Calf", ankle="CC_Base_{S}_Foot", foot="CC_Base_{S}_ToeBase")
    | _sided(collar="CC_Base_{S}_Clavicle", shoulder="CC_Base_{S}_Upperarm")
    | _sided(elbow="CC_Base_{S}_Forearm", wrist="CC_Base_{S}_Hand"),
    "cmu-amc": {"pelvis": "root", "spine1": "upperback", "spine2": "thorax", "neck": "lowerneck", "head": "head"}
    | _sided(hip="{s}femur", knee="{s}tibia", ankle="{s}foot", foot="{s}toes")
    | _sided(collar="{s}clavicle", shoulder="{s}humerus", elbow="{s}radius", wrist="{s}wrist"),
    "daz": {"pelvis": "hip", "spine1": "abdomen", "spine3": "chest", "neck": "neck", "head": "head"}
    | _sided(hip="{s}Thigh", knee="{s}Shin", ankle="{s}Foot", foot="{s}Foot End Site")
    | _sided(collar="{s}Collar", shoulder="{s}Shldr", elbow="{s}ForeArm", wrist="{s}Hand"),
    "rigify": {"pelvis": "DEF-hips", "spine1": "DEF-spine.001", "spine2": "DEF-spine.002", "spine3": "DEF-spine.003"}
    | {"neck": "DEF-neck", "head": "DEF-head"}
    | _sided(hip="DEF-thigh.{S}", knee="DEF-shin.{S}", ankle="DEF-foot.{S}", foot="DEF-toe.{S}")
    | _sided(collar="DEF-shoulder.{S}", shoulder="DEF-upper_arm.{S}", elbow="DEF-forearm.{S}", wrist="DEF-hand.{S}"),
    "accad": {"pelvis": "Hips", "spine1": "ToSpine", "spine2": "Spine", "spine3": "Spine1", "neck": "Neck"}
    | {"head": "Head", "left_foot": "LeftToeBase", "right_foot": "RightToeBase"}
    | _MIXAMO_ARMS,
    "cmu-cgspeed-max": {"spine1": "lowerback", "spine2": "Chest", "spine3": "Chest2"}
    | {joint: name for joint, name in _XSENS.items() if not joint.startswith("spine")},
    # Its joint `head` is at the base of the neck.
    "kaykit": {"pelvis": "hips", "spine1": "spine", "spine3": "chest", "neck": "head"}
    | _sided(hip="upperleg.{s}", knee="lowerleg.{s}", ankle="foot.{s}", foot="toes.{s}")
    | _sided(shoulder="upperarm.{s}", elbow="lowerarm.{s}", wrist="wrist.{s}"),
}
_FROM_DOCUMENTATION = {
    "mixamo": {"pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck"}
    | {"head": "Head", "left_foot": "LeftToeBase", "right_foot": "RightToeBase"}
    | _MIXAMO_ARMS,
    "lafan1": {"pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck"}
    | {"head": "Head", "left_foot": "LeftToe", "right_foot": "RightToe"}
    | _MIXAMO_ARMS,
    "cmu-cgspeed": {"pelvis": "Hips", "spine1": "LowerBack", "spine2": "Spine", "spine3": "Spine1", "neck": "Neck"}
    | {"head": "Head", "left_foot": "LeftToeBase", "right_foot": "RightToeBase"}
    | _MIXAMO_ARMS,
    "smpl": {"pelvis": "Pelvis", "spine1": "Spine1", "spine2": "Spine2", "spine3": "Spine3", "neck": "Neck"}
    | {"head": "Head"}
    | _sided(hip="{S}_Hip", knee="{S}_Knee", ankle="{S}_Ankle", foot="{S}_Foot")
    | _sided(collar="{S}_Collar", shoulder="{S}_Shoulder", elbow="{S}_Elbow", wrist="{S}_Wrist"),
    "100style": _XSENS,
    "xsens": _XSENS,
    "rokoko": {"pelvis": "Hips", "spine1": "Spine1", "spine2": "Spine2", "spine3": "Spine4", "neck": "Neck"}
    | {"head": "Head"}
    | _sided(hip="{side}Thigh", knee="{side}Shin", ankle="{side}Foot", foot="{side}Toe")
    | _sided(collar="{side}Shoulder", shoulder="{side}Arm", elbow="{side}ForeArm", wrist="{side}Hand"),
    "unreal": {"pelvis": "pelvis", "spine1": "spine_01", "spine2": "spine_02", "spine3": "spine_03"}
    | {"neck": "neck_01", "head": "head"}
    | _sided(hip="thigh_{s}", knee="calf_{s}", ankle="foot_{s}", foot="ball_{s}")
    | _sided(collar="clavicle_{s}", shoulder="upperarm_{s}", elbow="lowerarm_{s}", wrist="hand_{s}"),
    "vrm": {"pelvis": "hips", "spine1": "spine", "spine2": "chest", "spine3": "upperChest", "neck": "neck"}
    | {"head": "head"}
    | _sided(hip="{low}UpperLeg", knee="{low}LowerLeg", ankle="{low}Foot", foot="{low}Toes", collar="{low}Shoulder")
    | _sided(shoulder="{low}UpperArm", elbow="{low}LowerArm", wrist="{low}Hand"),
}
RIGS: dict[str, Rig] = {
    name: make_rig(table, name=name, was_tried=tables is _TRIED)
    for tables in (_TRIED, _FROM_DOCUMENTATION)
    for name, table in tables.items()
}


def rig_joint_names(names: JointNames) -> tuple[str, ...]:
    """Returns what the joints of HumanML3D are called in a rig, in their order."""
    table = {joint: spellings[0] for joint, spellings in RIGS[names].sources}
    # Programs look for Mixamo's characters by this namespace.
    prefix = "mixamorig:" if names == "mixamo" else ""
    return tuple(prefix + table[joint] for joint in HUMANML3D.joint_names)


def detect_rig(joint_names: Sequence[str]) -> Rig:
    """Returns the first named rig whose joints are all in `joint_names`.

    Raises:
        UserError: There is none.
    """
    # In the order of the tables, those that were tried first: several rigs may fit, as Mixamo's names are widespread.
    complete = [rig for rig in RIGS.values() if len(match_rig(rig, joint_names)) == len(rig.sources)]
    if not complete:
        shown = ", ".join(joint_names[:6])
        raise UserError(
            f"no known rig has its joints ({shown}, ...); `t2m data rig FILE` writes the best guess of a table, "
            "to be checked and given as --rig"
        )
    return complete[0]
