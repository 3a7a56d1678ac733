"""The rig of a clip that nobody named: a known table, or what the names and the bones say."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.rig.anatomy import Bones, find_joints, make_bones
from t2m_jax.motion.rig.clip import MAX_JOINTS, RigClip
from t2m_jax.motion.rig.person import leg_length
from t2m_jax.motion.rig.rigs import OPTIONAL_JOINTS, Rig, match_rig
from t2m_jax.motion.rig.tables import find_table, refusal
from t2m_jax.motion.skeleton import HUMANML3D


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
