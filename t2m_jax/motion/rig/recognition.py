"""What the names and the bones of a clip say: its rig, how large the person is, and whether it is a person at all."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError, printable
from t2m_jax.motion.rig.anatomy import Bones, find_figures, find_joints, make_bones
from t2m_jax.motion.rig.clip import MAX_JOINTS, RigClip
from t2m_jax.motion.rig.placing import Joints
from t2m_jax.motion.rig.rigs import OPTIONAL_JOINTS, Rig, find_table, match_rig, refusal
from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import HUMANML3D, JOINT

SIDES = ("left", "right")
STATURE_PER_LEG = 2.07
"""Height of an adult per length of thigh and shin: 1.70 m and 0.82 m."""
ADULT = 1.7
"""Height in meters that a figure of unknown unit gets."""
COMMON_UNITS = {1.0: "meters", 0.01: "centimeters", 0.001: "millimeters"}
OTHER_UNITS = {0.0254: "inches", 0.3048: "feet", 0.1: "decimeters", 0.0254 / 0.45: "units of CMU's skeletons (5.64 cm)"}
COMMON_HEIGHTS = (1.2, 2.4)
"""Heights in meters of people in files with a usual unit; children and tall men of a game are among them."""
OTHER_HEIGHTS = (1.5, 2.05)
"""The same for rare units, which must fit better, because there are many of them."""
ARM_PER_LEG = 0.9
"""Longest arm of a person, from shoulder to wrist, in legs from hip to ankle. People have 0.65, apes and dogs 1."""
LEG_PER_TRUNK = 1.05
"""Shortest leg of a person in trunks from pelvis to neck. People have 1.5, dogs and horses up to 0.9."""
FOOT_PER_SHIN = 0.75
"""Longest foot of a person, from ankle to ball, in shins. People have 0.35; animals that walk on their toes 0.8."""
LEVEL = 0.5
"""Cosine of directions that are nearly at a right angle, such as a level trunk and the vertical, or less."""
LOW_HANDS = 0.3
"""Hands are on the floor if they are lower than this part of the neck's height. Hanging hands are at half of it."""
ALWAYS = 0.8
"""Share of the frames in which an animal is on all fours."""
POSSIBLE_HEIGHTS = (0.4, 3.0)
"""Heights in meters, by the length of legs, of figures in formats that are in meters by definition: dolls, giants."""


def clip_bones(clip: RigClip) -> Bones:
    """Returns the hierarchy of a clip with its end sites, with the lengths that the bones have in the motion."""
    clip = clip.with_end_sites()
    return make_bones(clip.joint_names, clip.parents, np.median(clip.translations, axis=0))


def measure_leg(
    names: Sequence[str], parents: Sequence[int], bones: Float[np.ndarray, "J 3"], rig: Rig | None
) -> float:
    """Returns the length of a leg in the unit of the bones, 0 if no legs were found."""
    if len(names) > MAX_JOINTS:
        return 0.0
    figure = make_bones(names, parents, bones)
    table = rig or find_table(names)
    found: Mapping[str, int] = match_rig(table, names) if table else {}
    # A table may name joints of which the file has none.
    return leg_length(figure, found) or leg_length(figure, find_joints(figure))


def in_human_size(clip: RigClip) -> RigClip:
    """Returns a clip in meters by its file. The unit of a figure that no person can be is guessed; `notes` say it."""
    # By the legs: hats, hair and weapons are above many figures, so their height says less.
    leg = measure_leg(clip.joint_names, clip.parents, np.median(clip.translations, axis=0), None)
    if leg == 0 or POSSIBLE_HEIGHTS[0] <= STATURE_PER_LEG * leg <= POSSIBLE_HEIGHTS[1]:
        return clip
    unit, said = unit_from_leg(leg / clip.metres_per_unit)
    said = said or f"lengths are taken as {COMMON_UNITS[unit]}"
    return dataclasses.replace(clip.scaled(unit / clip.metres_per_unit), notes=(*clip.notes, said))


def guess_table(clip: RigClip) -> dict[str, str]:
    """Returns joints of HumanML3D -> the joints of a clip that were recognized by their names and by anatomy.

    Raises:
        UserError: The figure has too many joints.
    """
    if len(clip.joint_names) > MAX_JOINTS:
        raise UserError(refusal(clip.joint_names))
    bones = clip_bones(clip)
    found = find_joints(bones)
    return {role: bones.names[found[role]] for role in HUMANML3D.joint_names if role in found}


def recognize(clip: RigClip) -> Rig:
    """Returns a rig from the names and the bones of a clip.

    Raises:
        UserError: A joint was not found without which there is no motion of a person.
    """
    table = guess_table(clip)
    missing = [name for name in HUMANML3D.joint_names if name not in table]
    needed = [name for name in missing if name not in OPTIONAL_JOINTS]
    if needed:
        raise UserError(refusal(clip.joint_names, needed))
    sources = tuple((role, (name,)) for role, name in table.items())
    note = "no table has these joints, so they were recognized by their names and by anatomy"
    placed = f"; placed by proportions: {', '.join(missing)}" if missing else ""
    return Rig(name="recognized by names and anatomy", sources=sources, note=note + placed)


def leg_length(bones: Bones, joints: Mapping[str, int]) -> float:
    """Returns the mean length of thigh and shin in the unit of the bones; 0 if a joint of the legs is not known."""
    # Of both sides, because the sides of people who were measured differ by millimeters.
    line = ("hip", "knee", "ankle")
    if any(f"{side}_{name}" not in joints for side in SIDES for name in line):
        return 0.0
    return _mean_length(bones, joints, *itertools.pairwise(line))


def _mean_length(bones: Bones, joints: Mapping[str, int], *pairs: tuple[str, str]) -> float:
    """Returns the length of some bones of both sides, divided by two."""
    ways = (_way(bones, joints[f"{side}_{a}"], joints[f"{side}_{b}"]) for side in SIDES for a, b in pairs)
    return sum(ways) / 2


def _way(bones: Bones, first: int, last: int) -> float:
    """Returns the length of the bones from one joint to another, also if neither is above the other."""
    meeting = bones.meeting(first, last)
    return bones.length(meeting, first) + bones.length(meeting, last)


def unit_from_leg(leg: float) -> tuple[float, str]:
    """Returns meters per unit for a leg of this length, and what to say of it; nothing for a usual unit."""
    height = STATURE_PER_LEG * leg
    for units, (low, high) in ((COMMON_UNITS, COMMON_HEIGHTS), (OTHER_UNITS, OTHER_HEIGHTS)):
        fitting = [unit for unit in units if low <= unit * height <= high]
        if fitting:
            # By the ratio, because units differ by factors.
            unit = min(fitting, key=lambda one: abs(np.log(one * height / ADULT)))
            return unit, "" if units is COMMON_UNITS else f"lengths are taken as {units[unit]}"
    unit = ADULT / height
    return unit, f"its unit is not known; the figure is scaled to a person of {ADULT} m (1 is {100 * unit:.3g} cm)"


def check_is_one(bones: Bones) -> None:
    """Raises `UserError` for a file with several people, of whom none is likelier than the others."""
    people = [bones.names[figure.top] for figure in find_figures(bones)]
    if len(people) > 1:
        raise UserError(
            f"the file seems to hold several people (below the joints {printable(', '.join(people))}); "
            "`t2m data rig FILE` writes the best guess of a table, to be checked and given as --rig"
        )


def check_is_person(bones: Bones, joints: Mapping[str, int], positions: Joints) -> None:
    """Raises `UserError` for the joints of an animal, whose limbs have names as those of a person.

    Two signs are needed: people may crawl in a whole clip, and characters may have a tail or short legs.

    Args:
        bones: The hierarchy.
        joints: The joints of HumanML3D in it.
        positions: The motion of the 22 joints, Y up.
    """
    leg = leg_length(bones, joints)
    arm = _mean_length(bones, joints, ("shoulder", "elbow"), ("elbow", "wrist"))
    shin = _mean_length(bones, joints, ("knee", "ankle"))
    has_feet = {"left_foot", "right_foot"} <= joints.keys()
    foot = _mean_length(bones, joints, ("ankle", "foot")) if has_feet else 0.0
    trunk = _way(bones, joints["pelvis"], joints["neck"]) if "neck" in joints else 0.0
    tails = [bones.names[joint] for joint, words in enumerate(bones.words) if words.is_animal]
    signs = {
        f"joint {tails[0]!r}" if tails else "": bool(tails),
        # Arms as long as the legs, and legs shorter than the trunk, are one sign: many drawn people have short legs.
        "short legs": arm > ARM_PER_LEG * leg or leg < LEG_PER_TRUNK * trunk,
        "long feet": foot > FOOT_PER_SHIN * shin,
        "on all fours": _is_on_all_fours(positions),
    }
    seen = [sign for sign, is_seen in signs.items() if is_seen]
    if len(seen) > 1:
        raise UserError(
            f"this seems to be an animal ({', '.join(seen)}); only people are read; --rig TABLE reads it as one"
        )


def _is_on_all_fours(positions: Joints) -> bool:
    """Returns whether the trunk is level, or the hands are near the floor, in nearly all frames."""
    pelvis, neck = positions[:, JOINT["pelvis"]], positions[:, JOINT["neck"]]
    hip, ankle, shoulder, wrist = (
        positions[:, [JOINT[f"{side}_{name}"] for side in SIDES]] for name in ("hip", "ankle", "shoulder", "wrist")
    )
    trunk = unit_vectors(neck - pelvis)
    leg, arm = (unit_vectors(np.sum(end - start, axis=1)) for start, end in ((hip, ankle), (shoulder, wrist)))
    is_level = np.abs(trunk[:, 1]) < LEVEL
    # Also if the wrong axis seems to point up: it is the one along the trunk.
    is_level |= (np.abs(np.sum(trunk * leg, axis=-1)) < LEVEL) & (np.sum(leg * arm, axis=-1) > LEVEL)
    floor = positions[..., 1].min(axis=1)
    hands = wrist[..., 1].max(axis=1) - floor < LOW_HANDS * (neck[:, 1] - floor)
    return bool(np.mean(is_level | hands) > ALWAYS)
