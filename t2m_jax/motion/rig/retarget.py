"""Conversion from the joints of a BVH file to the 22 joints of HumanML3D."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rig.orientation import Up, find_up, to_y_up
from t2m_jax.motion.rig.rigs import Rig, load_rig, make_rig, match_rig
from t2m_jax.motion.rig.tables import RIGS, detect_rig
from t2m_jax.motion.skeleton import HUMANML3D

RigLike = Rig | str | Mapping[str, str | Sequence[str]]

World = Float[np.ndarray, "T S 3"]
"""Positions of the joints of a file."""
Joints = Float[np.ndarray, "T 22 3"]
"""Positions of the joints of HumanML3D."""

_SPINE = ("pelvis", "spine1", "spine2", "spine3", "neck")
# Place of a collar joint that the rig does not have: the part of the way from spine3 to the neck, and from there to
# the shoulder.
_COLLAR_UP = 0.5
_COLLAR_OUT = 0.45


def retarget(clip: RigClip, *, rig: RigLike | None = None, up: Up = "auto") -> Motion:
    """Returns the clip as a motion of the 22 joints with Y up, with its own size, place and frame rate.

    The result keeps the bone lengths of the file. `features_from_positions` converts them to the template's.

    Args:
        clip: A clip.
        rig: A rig, the name of one, the path of a YAML file (`*.yaml`) or a table `{"pelvis": "Hips", …}`.
            By default the named rig whose joints the clip has.
        up: The axis of the clip that points up; by default the one along which the figure stands.

    Raises:
        UserError: The clip does not have the joints of the rig, or it cannot be told which axis points up.
    """
    clip = clip.with_end_sites()
    index = match_clip(clip, find_rig(clip, rig))
    positions = _retarget(clip.positions, clip.parents, index)
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
    return _find_up(clip, _retarget(clip.positions, clip.parents, index), index)


def _find_up(clip: RigClip, positions: Joints, index: Mapping[str, int]) -> Literal["y", "z"]:
    """Returns the axis that points up, from the joints of a clip with end sites."""
    up = find_up(positions, _retarget(clip.rest_positions[None], clip.parents, index)[0])
    if up is None:
        raise UserError("the figure may stand with Z up, or lie with Y up; say which with --up z or --up y")
    return up


def find_rig(clip: RigClip, rig: RigLike | None) -> Rig:
    """Returns the rig that `retarget` uses for a clip.

    Raises:
        UserError: The rig is unknown, or no known rig has the joints of the clip.
    """
    if rig is None:
        return detect_rig(clip.with_end_sites().joint_names)
    if isinstance(rig, Rig):
        return rig
    if isinstance(rig, Mapping):
        return make_rig(rig, name="the given rig")
    if rig in RIGS:
        return RIGS[rig]
    if not rig.endswith((".yaml", ".yml")):
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


def _retarget(world: World, parents: Sequence[int], index: Mapping[str, int]) -> Joints:
    """Returns the joints of HumanML3D; those that the rig does not have are placed between their neighbors."""
    joints = {joint: world[:, source] for joint, source in index.items()}
    _place_spine(joints, index, world, parents)
    chest = joints["spine3"]
    neck = joints["neck"]
    for side in ("left", "right"):
        if f"{side}_collar" not in joints:
            base = chest + _COLLAR_UP * (neck - chest)
            joints[f"{side}_collar"] = base + _COLLAR_OUT * (joints[f"{side}_shoulder"] - base)
    if "head" not in joints:
        joints["head"] = neck + 0.5 * (neck - chest)
    return np.stack([joints[name] for name in HUMANML3D.joint_names], axis=1).astype(np.float32)


def _place_spine(
    joints: dict[str, Float[np.ndarray, "T 3"]], index: Mapping[str, int], world: World, parents: Sequence[int]
) -> None:
    """Adds the missing joints between pelvis and neck: on the file's own spine, with the template's proportions."""
    template = [HUMANML3D.bone_lengths[HUMANML3D.joint_names.index(name)] for name in _SPINE]
    heights = dict(zip(_SPINE, np.cumsum(template), strict=True))
    known = [name for name in _SPINE if name in index]
    for below, above in itertools.pairwise(known):
        chain = [index[above]]
        while chain[-1] != index[below] and parents[chain[-1]] >= 0:
            chain.append(parents[chain[-1]])
        if chain[-1] != index[below]:  # the upper joint is not a descendant of the lower one
            chain = [index[above], index[below]]
        path = world[:, chain[::-1]]
        lengths = np.linalg.norm(np.diff(path, axis=1), axis=-1).mean(axis=0)
        ends = np.cumsum(lengths)
        for name in _SPINE[_SPINE.index(below) + 1 : _SPINE.index(above)]:
            fraction = (heights[name] - heights[below]) / (heights[above] - heights[below])
            place = fraction * lengths.sum()
            segment = min(int(np.searchsorted(ends, place)), len(lengths) - 1)
            weight = 1 - (ends[segment] - place) / max(lengths[segment], 1e-9)
            joints[name] = path[:, segment] * (1 - weight) + path[:, segment + 1] * weight
