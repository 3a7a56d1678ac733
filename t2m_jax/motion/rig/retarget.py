"""Conversion from the joints of a BVH file to the 22 joints of HumanML3D."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.motion.kinematics import forward_kinematics
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rig.orientation import Up, find_up, stands_along_z_alone, to_y_up
from t2m_jax.motion.rig.placing import Joints, place_joints
from t2m_jax.motion.rig.recognition import check_is_one, check_is_person, clip_bones, recognize
from t2m_jax.motion.rig.rigs import DOLLS, RIGS, Rig, find_table, load_rig, make_rig, match_rig

RigLike = Rig | str | Mapping[str, str | Sequence[str]]
SMALLEST = 0.01
"""Meters of a figure below which its joints are in one place."""


def retarget(clip: RigClip, *, rig: RigLike | None = None, up: Up = "auto") -> Motion:
    """Returns the clip as a motion of the 22 joints with Y up, with its own size, place and frame rate.

    The result keeps the bone lengths of the file. `features_from_positions` converts them to the template's.

    Args:
        clip: A clip.
        rig: A rig, the name of one, the path of a YAML file (`*.yaml`) or a table `{"pelvis": "Hips", …}`.
            By default the named rig whose joints the clip has or, without one, what names and bones say.
        up: The axis of the clip that points up; by default the one along which the figure stands.

    Raises:
        UserError: The clip does not have the joints of the rig, its bones have no length, or it cannot be told which
            axis points up.
    """
    clip = clip.with_end_sites()
    index = match_clip(clip, find_rig(clip, rig))
    positions = place_joints(clip.positions, clip.parents, index)
    if np.ptp(positions, axis=1).max() < SMALLEST:
        raise UserError("all joints are in one place; the skeleton has no bones with a length")
    if up == "auto":
        up = _find_up(clip, positions, index)
    return Motion(
        positions=to_y_up(positions) if up == "z" else positions,
        fps=clip.fps,
        # Clips have pairs, as files do; the record has two tuples.
        part_starts=tuple(first for first, _ in clip.parts),
        part_captions=tuple(text for _, text in clip.parts),
    )


def clip_up(clip: RigClip, rig: Rig) -> Literal["y", "z"]:
    """Returns the axis of a clip that points up, as `retarget` finds it.

    Raises:
        UserError: The clip does not have the joints of the rig, or it cannot be told which axis points up.
    """
    clip = clip.with_end_sites()
    index = match_clip(clip, rig)
    return _find_up(clip, place_joints(clip.positions, clip.parents, index), index)


def _find_up(clip: RigClip, positions: Joints, index: Mapping[str, int]) -> Literal["y", "z"]:
    """Returns the axis that points up, from the joints of a clip with end sites."""
    up = find_up(positions, place_joints(clip.rest_positions[None], clip.parents, index)[0])
    if up is None:
        raise UserError("the figure may stand with Z up, or lie with Y up; say which with --up z or --up y")
    return up


def lying_note(clip: RigClip, rig: Rig) -> str:
    """Returns what to say of a GLB file whose figure lies because Z seems to be up; nothing otherwise."""
    if clip.rest_rotations is None:
        return ""
    index = match_clip(clip, rig)
    rest = forward_kinematics(clip.rest_rotations[None], clip.offsets[None], clip.parents).positions
    positions, (pose,) = (place_joints(world, clip.parents, index) for world in (clip.positions, rest))
    if not stands_along_z_alone(positions, pose):
        return ""
    return "THE FIGURE LIES with Y up, as glTF demands; its rest pose stands if Z is up, so choose this axis"


def find_rig(clip: RigClip, rig: RigLike | None) -> Rig:
    """Returns the rig that `retarget` uses for a clip.

    Raises:
        UserError: The rig is unknown, no known rig has the joints of the clip and they were not recognized, or it is an
            animal or several people.
    """
    if rig is None:
        found = find_table(clip.with_end_sites().joint_names) or recognize(clip)
        check_is_one(clip_bones(clip))
        if not clip.is_person and found.name not in DOLLS:
            _check_is_person(clip, found)
        return found
    return resolve_rig(rig)


def _check_is_person(clip: RigClip, rig: Rig) -> None:
    """Raises `UserError` if a clip shows an animal, whose joints may have the names of a person's."""
    clip = clip.with_end_sites()
    index = match_rig(rig, clip.joint_names)
    positions = place_joints(clip.positions, clip.parents, index)
    rest = place_joints(clip.rest_positions[None], clip.parents, index)[0]
    up = find_up(positions, rest)
    check_is_person(clip_bones(clip), index, to_y_up(positions) if up == "z" else positions)


def resolve_rig(rig: RigLike) -> Rig:
    """Returns a rig by its name, its file or its table.

    Raises:
        UserError: There is none of this name, or the file or the table is not correct.
    """
    if isinstance(rig, Rig):
        return rig
    if isinstance(rig, Mapping):
        return make_rig(rig, name="the given rig")
    if rig in RIGS:
        return RIGS[rig]
    if not rig.lower().endswith((".yaml", ".yml")):
        raise UserError(f'unknown rig "{rig}"; known are {", ".join(RIGS)}, or give a .yaml file')
    return load_rig(rig)


def match_clip(clip: RigClip, rig: Rig) -> dict[str, int]:
    """Returns the joint of the clip for each joint of the rig.

    Raises:
        UserError: The clip does not have one of them.
    """
    index = match_rig(rig, clip.joint_names)
    for joint, spellings in rig.sources:
        if joint not in index:
            wanted = " or ".join(f'"{spelling}"' for spelling in spellings)
            raise UserError(f"rig {rig.name}: the file has no joint {wanted} for {joint}; choose another rig")
    return index
