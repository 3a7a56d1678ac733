"""Conversion from the joints of a BVH file to the 22 joints of HumanML3D."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.bvh.clip import BvhClip
from t2m_jax.motion.bvh.rigs import RIGS, Rig, detect_rig, load_rig, make_rig, match_rig
from t2m_jax.motion.record import Motion
from t2m_jax.motion.skeleton import HUMANML3D

RigLike = Rig | str | Mapping[str, str | Sequence[str]]

_SPINE = ("pelvis", "spine1", "spine2", "spine3", "neck")
# Place of a collar joint that the rig does not have: the part of the way from spine3 to the neck, and from there to
# the shoulder.
_COLLAR_UP, _COLLAR_OUT = 0.5, 0.45


def retarget(clip: BvhClip, *, rig: RigLike | None = None) -> Motion:
    """Returns the clip as a motion of the 22 joints, with its own size, place and frame rate.

    The result keeps the bone lengths of the file. `features_from_positions` converts them to the template's.

    Args:
        clip: A clip with Y up.
        rig: A rig, the name of one, the path of a YAML file (`*.yaml`) or a table `{"pelvis": "Hips", …}`.
            By default the named rig whose joints the clip has.
    """
    clip = clip.with_end_sites()
    if rig is None:
        rig = detect_rig(clip.joint_names)
    elif isinstance(rig, Mapping):
        rig = make_rig(rig, name="the given rig")
    elif isinstance(rig, str) and rig in RIGS:
        rig = RIGS[rig]
    elif isinstance(rig, str):
        if not rig.endswith((".yaml", ".yml")):
            raise UserError(f'unknown rig "{rig}"; known are {", ".join(RIGS)}, or give a .yaml file')
        rig = load_rig(rig)
    index = match_rig(rig, clip.joint_names)
    for joint, spellings in rig.sources:
        if joint not in index:
            wanted = " or ".join(f'"{spelling}"' for spelling in spellings)
            raise UserError(f"rig {rig.name}: the file has no joint {wanted} for {joint}; choose another rig")
    world = clip.positions
    joints = {joint: world[:, source] for joint, source in index.items()}
    _place_spine(joints, index, world, clip.parents)
    chest, neck = joints["spine3"], joints["neck"]
    for side in ("left", "right"):
        if f"{side}_collar" not in joints:
            base = chest + _COLLAR_UP * (neck - chest)
            joints[f"{side}_collar"] = base + _COLLAR_OUT * (joints[f"{side}_shoulder"] - base)
    if "head" not in joints:
        joints["head"] = neck + 0.5 * (neck - chest)
    positions = np.stack([joints[name] for name in HUMANML3D.joint_names], axis=1)
    return Motion(positions=positions.astype(np.float32), fps=clip.fps)


def _place_spine(
    joints: dict[str, Float[np.ndarray, "T 3"]],
    index: Mapping[str, int],
    world: Float[np.ndarray, "T S 3"],
    parents: Sequence[int],
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
