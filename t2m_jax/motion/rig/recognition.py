"""The rig of a clip that nobody named: a known table, or what the names and the bones say."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.rig.anatomy import Bones, find_joints, make_bones
from t2m_jax.motion.rig.clip import MAX_JOINTS, RigClip
from t2m_jax.motion.rig.person import COMMON_UNITS, STATURE_PER_LEG, leg_length, unit_from_leg
from t2m_jax.motion.rig.rigs import OPTIONAL_JOINTS, Rig, match_rig
from t2m_jax.motion.rig.tables import find_table, refusal
from t2m_jax.motion.skeleton import HUMANML3D

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
    """Returns a clip whose lengths should be meters; a figure that no person can be is scaled, and `notes` say it."""
    leg = measure_leg(clip.joint_names, clip.parents, np.median(clip.translations, axis=0), None)
    if leg == 0 or POSSIBLE_HEIGHTS[0] <= STATURE_PER_LEG * leg <= POSSIBLE_HEIGHTS[1]:
        return clip
    unit, said = unit_from_leg(leg)
    said = said or f"lengths are taken as {COMMON_UNITS[unit]}"
    return dataclasses.replace(clip.scaled(unit), notes=(*clip.notes, said))


def recognize(clip: RigClip) -> Rig:
    """Returns a rig from the names and the bones of a clip.

    Raises:
        UserError: A joint was not found without which there is no motion of a person.
    """
    if len(clip.joint_names) > MAX_JOINTS:
        raise UserError(refusal(clip.joint_names))
    bones = clip_bones(clip)
    found = find_joints(bones)
    missing = [name for name in HUMANML3D.joint_names if name not in found]
    needed = [name for name in missing if name not in OPTIONAL_JOINTS]
    if needed:
        raise UserError(refusal(bones.names, needed))
    sources = tuple((name, (bones.names[found[name]],)) for name in HUMANML3D.joint_names if name in found)
    note = "no table has these joints, so they were recognized by their names and by anatomy"
    placed = f"; placed by proportions: {', '.join(missing)}" if missing else ""
    return Rig(name="recognized by names and anatomy", sources=sources, note=note + placed)
