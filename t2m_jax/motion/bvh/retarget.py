"""From the joints of a BVH file to the 22 joints of HumanML3D."""

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
# Where a collar joint lies that the rig lacks: up from spine3 to the neck, then out to the shoulder.
_COLLAR_UP, _COLLAR_OUT = 0.5, 0.45


def retarget(clip: BvhClip, *, rig: RigLike | None = None) -> Motion:
    """Returns the clip as a motion of the 22 joints, at its own size, place and frame rate.

    The result keeps the bone lengths of the file; `features_from_positions` gives it those of the template.

    Args:
        clip: What `load_bvh` returned; Y must be up.
        rig: A rig, the name of one, the path of a YAML file (`*.yaml`) or a table `{"pelvis": "Hips", …}`.
            By default the named rig whose joints the clip has.
    """
    rig = _resolve_rig(rig, clip.joint_names)
    index = match_rig(rig, clip.joint_names)
    for joint, spellings in rig.sources:
        if joint not in index:
            wanted = " or ".join(f'"{spelling}"' for spelling in spellings)
            raise UserError(f"rig {rig.name}: the file has no joint {wanted}, which stands for {joint}")
    world = clip.positions
    joints = {joint: world[:, source] for joint, source in index.items()}
    _place_spine(joints, index, world, clip.parents)
    _place_collars_and_head(joints)
    positions = np.stack([joints[name] for name in HUMANML3D.joint_names], axis=1)
    return Motion(positions=positions.astype(np.float32), fps=clip.fps)


def _resolve_rig(rig: RigLike | None, joint_names: Sequence[str]) -> Rig:
    if rig is None:
        return detect_rig(joint_names)
    if isinstance(rig, Rig):
        return rig
    if isinstance(rig, Mapping):
        return make_rig(rig, name="the given rig")
    if rig in RIGS:
        return RIGS[rig]
    if rig.endswith((".yaml", ".yml")):
        return load_rig(rig)
    raise UserError(f'unknown rig "{rig}"; known are {", ".join(RIGS)}, or give a .yaml file')


def _place_spine(
    joints: dict[str, Float[np.ndarray, "T 3"]],
    index: Mapping[str, int],
    world: Float[np.ndarray, "T S 3"],
    parents: Sequence[int],
) -> None:
    """Adds the missing joints between pelvis and neck, on the file's own spine, spaced as in the template."""
    lengths = [HUMANML3D.bone_lengths[HUMANML3D.joint_names.index(name)] for name in _SPINE]
    heights = dict(zip(_SPINE, np.cumsum(lengths), strict=True))
    known = [name for name in _SPINE if name in index]
    for below, above in itertools.pairwise(known):
        path = world[:, _joints_between(index[below], index[above], parents)]
        for name in _SPINE[_SPINE.index(below) + 1 : _SPINE.index(above)]:
            fraction = (heights[name] - heights[below]) / (heights[above] - heights[below])
            joints[name] = _point_along(path, fraction)


def _joints_between(lower: int, upper: int, parents: Sequence[int]) -> list[int]:
    """Returns the joints on the way from `lower` to its descendant `upper`, both included."""
    path = [upper]
    while path[-1] != lower and parents[path[-1]] >= 0:
        path.append(parents[path[-1]])
    return path[::-1] if path[-1] == lower else [lower, upper]


def _point_along(path: Float[np.ndarray, "T N 3"], fraction: float) -> Float[np.ndarray, "T 3"]:
    """Returns the point at `fraction` of the length of a line of joints, whose mean lengths count."""
    lengths = np.linalg.norm(np.diff(path, axis=1), axis=-1).mean(axis=0)
    place = fraction * lengths.sum()
    ends = np.cumsum(lengths)
    segment = min(int(np.searchsorted(ends, place)), len(lengths) - 1)
    weight = 1 - (ends[segment] - place) / max(lengths[segment], 1e-9)
    return path[:, segment] * (1 - weight) + path[:, segment + 1] * weight


def _place_collars_and_head(joints: dict[str, Float[np.ndarray, "T 3"]]) -> None:
    """Adds collars and head where the rig has none."""
    chest, neck = joints["spine3"], joints["neck"]
    for side in ("left", "right"):
        if f"{side}_collar" not in joints:
            base = chest + _COLLAR_UP * (neck - chest)
            joints[f"{side}_collar"] = base + _COLLAR_OUT * (joints[f"{side}_shoulder"] - base)
    if "head" not in joints:
        joints["head"] = neck + 0.5 * (neck - chest)
