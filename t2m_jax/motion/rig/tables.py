"""The rigs that are known by name, from `rigs.yaml`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from t2m_jax.errors import UserError
from t2m_jax.motion.rig.rigs import Rig, make_rig, match_rig
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.yaml_file import load_yaml

JointNames = Literal["lafan1", "humanml3d", "mixamo", "vrm", "unreal"]
"""Rigs whose names for all 22 joints can be written."""


def _both_sides(table: Mapping[str, str]) -> dict[str, str]:
    """Returns a table of the file with a line for each joint."""
    found = {}
    for joint, name in table.items():
        for side in ("Left", "Right") if joint not in HUMANML3D.joint_names else ("",):
            initial = side[:1]
            full = f"{side.lower()}_{joint}" if side else joint
            found[full] = name.format(side=side, low=side.lower(), S=initial, s=initial.lower())
    return found


RIGS: dict[str, Rig] = {
    name: make_rig(_both_sides(table), name=name, was_tried=section == "tried_on_files")
    for section, tables in load_yaml(Path(__file__).with_name("rigs.yaml")).data.items()
    for name, table in tables.items()
}


DOLLS = ("kaykit",)
"""Rigs of characters that do not have the proportions of a person."""


def rig_joint_names(names: JointNames) -> tuple[str, ...]:
    """Returns what the joints of HumanML3D are called in a rig, in their order."""
    table = {joint: spellings[0] for joint, spellings in RIGS[names].sources}
    # Programs look for Mixamo's characters by this namespace.
    prefix = "mixamorig:" if names == "mixamo" else ""
    return tuple(prefix + table[joint] for joint in HUMANML3D.joint_names)


def find_table(joint_names: Sequence[str]) -> Rig | None:
    """Returns the first named rig whose joints are all in `joint_names`, None if there is none."""
    # In the order of the tables, those that were tried first: several rigs may fit, as Mixamo's names are widespread.
    complete = (rig for rig in RIGS.values() if len(match_rig(rig, joint_names)) == len(rig.sources))
    return next(complete, None)


def detect_rig(joint_names: Sequence[str]) -> Rig:
    """Returns the first named rig whose joints are all in `joint_names`.

    Raises:
        UserError: There is none.
    """
    found = find_table(joint_names)
    if found is None:
        raise UserError(refusal(joint_names))
    return found


def refusal(joint_names: Sequence[str], missing: Sequence[str] = ()) -> str:
    """Returns why joints are not read, and what to do."""
    lacks = f", and {', '.join(missing)} were not recognized" if missing else ""
    return (
        f"no known rig has its joints ({', '.join(joint_names[:6])}, ...){lacks}; `t2m data rig FILE` writes the best "
        "guess of a table, to be checked and given as --rig"
    )
