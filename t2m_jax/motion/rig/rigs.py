"""Rigs: the joints of a file that correspond to the 22 joints of HumanML3D. `rigs.yaml` has those known by name."""

import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from t2m_jax.errors import UserError
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.yaml_file import load_yaml

JointNames = Literal["lafan1", "humanml3d", "mixamo", "vrm", "unreal", "smpl"]
"""Rigs whose names for all 22 joints can be written."""
DOLLS = ("kaykit",)
"""Rigs of characters that do not have the proportions of a person."""
# A rig may lack these joints. They are placed by the proportions of a person.
OPTIONAL_JOINTS = (
    "spine1", "spine2", "spine3", "neck", "head", "left_collar", "right_collar", "left_foot", "right_foot"
)  # fmt: skip


@dataclasses.dataclass(frozen=True, kw_only=True)
class Rig:
    """A table from the joints of HumanML3D to the joints of another hierarchy."""

    name: str
    """Name on the command line."""
    sources: tuple[tuple[str, tuple[str, ...]], ...]
    """Joints of HumanML3D with their names in the rig. The first name that a file has is used."""
    was_tried: bool = True
    """Whether the table was tried on real files, and does not only follow from documentation."""
    note: str = ""
    """How a rig without a table was found, as a part of a sentence to show."""


def make_rig(table: Mapping[str, str | Sequence[str]], *, name: str, was_tried: bool = True) -> Rig:
    """Returns the rig described by a table such as `{"pelvis": "Hips", "left_foot": ["LeftToe", "LeftToeBase"]}`.

    Args:
        table: From joints of HumanML3D to a joint of the file, or to several spellings of it. The joints of
            `OPTIONAL_JOINTS` may be missing.
        name: Name for error messages. For a table from a file, its path.
        was_tried: Whether the table was tried on real files.

    Raises:
        UserError: A joint is unknown, or one that is needed is missing.
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
    return Rig(name=name, sources=tuple(sources), was_tried=was_tried)


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


def match_rig(rig: Rig, joint_names: Sequence[str]) -> dict[str, int]:
    """Returns the index in `joint_names` of each HumanML3D joint; joints that the hierarchy does not have are left out.

    Upper case does not matter. Names match with or without a namespace (`mixamorig:Hips`), and with or without what all
    names begin with (`m_avg_Pelvis`).
    """
    index: dict[str, int] = {}
    shared = len(os.path.commonprefix(list(joint_names)))  # noqa: RUF071 - names, not paths
    for i, name in enumerate(joint_names):
        for spelling in (name, name.rpartition(":")[2], name[shared:]):
            index.setdefault(spelling.casefold(), i)
    found = {}
    for joint, spellings in rig.sources:
        # The first spelling that the file has: tables name the usual one first.
        hits = [index[spelling.casefold()] for spelling in spellings if spelling.casefold() in index]
        if hits:
            found[joint] = hits[0]
    return found


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


def rig_joint_names(names: JointNames) -> tuple[str, ...]:
    """Returns what the joints of HumanML3D are called in a rig, in their order."""
    table = {joint: spellings[0] for joint, spellings in RIGS[names].sources}
    # Programs look for Mixamo's characters by this namespace.
    prefix = "mixamorig:" if names == "mixamo" else ""
    return tuple(prefix + table[joint] for joint in HUMANML3D.joint_names)


def root_name(names: JointNames) -> str:
    """Returns what a root bone on the floor is called beside the joints of a rig. Unreal needs this spelling."""
    return "root" if names in ("humanml3d", "unreal") else "Root"


def find_table(joint_names: Sequence[str]) -> Rig | None:
    """Returns the first named rig whose joints are all in `joint_names`, None if there is none."""
    # In the order of the tables, those that were tried first: several rigs may fit, as Mixamo's names are widespread.
    complete = (rig for rig in RIGS.values() if len(match_rig(rig, joint_names)) == len(rig.sources))
    return next(complete, None)


def refusal(joint_names: Sequence[str], missing: Sequence[str] = ()) -> str:
    """Returns why joints are not read, and what to do."""
    lacks = f", and {', '.join(missing)} were not recognized" if missing else ""
    return (
        f"no known rig has its joints ({', '.join(joint_names[:6])}, ...){lacks}; `t2m data rig FILE` writes the best "
        "guess of a table, to be checked and given as --rig"
    )
