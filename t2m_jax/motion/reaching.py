"""Bringing the root, wrists and feet of a motion exactly to their targets. Bones keep their lengths.

A root moves over the ground with all of the body. A limb of two bones bends as needed, by inverse kinematics. Both
begin before the time of a target and end after it, so that nothing jumps.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from t2m_jax.motion.features import facing
from t2m_jax.motion.legs import move_foot, reaching_bends
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.motion.targets import ROOT, Target

FADE_SECONDS = 0.5
"""Time in which a movement to a target begins, and in which it ends."""
GROUND = np.array([1.0, 0.0, 1.0])

Clip = Float[np.ndarray, "T J 3"]
Limb = tuple[int, int, int, int]
"""The joint that stays, the one that bends, the end, and the toe that moves along; without one, the end again."""


def limbs_of(skeleton: Skeleton) -> dict[str, Limb]:
    """Returns the limbs that can bring a joint to a place, by its name: wrists, ankles and toes."""
    # By the place of the shoulders, because the skeletons name their joints differently.
    shoulders = skeleton.face_joints[2:]
    wrists = [chain[-1] for chain in skeleton.chains if set(chain) & set(shoulders)]
    ends = [(wrist, wrist) for wrist in wrists] + [skeleton.left_foot, skeleton.right_foot]
    limbs: dict[str, Limb] = {}
    for end, toe in ends:
        hinge = skeleton.parents[end]
        limb = (skeleton.parents[hinge], hinge, end, toe)
        limbs |= dict.fromkeys((skeleton.joint_names[end], skeleton.joint_names[toe]), limb)
    return limbs


def exact_joints(skeleton: Skeleton) -> list[str]:
    """Returns what an exact target may bring to its place: the root, and the ends of limbs."""
    return [ROOT, *limbs_of(skeleton)]


def check_exact(targets: Sequence[Target], skeleton: Skeleton) -> None:
    """Raises `UserError` if a target is exact and its joint cannot be brought to it by a limb."""
    known = exact_joints(skeleton)
    for target in targets:
        if target.exact and target.joint not in known:
            raise target.error(f"cannot be exact; these can: {', '.join(known)}")


def reach_exactly(motion: Motion, targets: Sequence[Target]) -> Motion:
    """Returns a motion that meets those targets that are exact, as far as its limbs reach."""
    exact = [target for target in targets if target.exact]
    if not exact:
        return motion
    limbs = limbs_of(motion.skeleton)
    positions = motion.positions.astype(np.float64)
    roots = [target for target in exact if target.joint == ROOT]
    positions += _shift(positions, roots, motion)[:, None]  # first, because it takes the limbs along
    for limb in dict.fromkeys(limbs[target.joint] for target in exact if target.joint != ROOT):
        own = [target for target in exact if target.joint != ROOT and limbs[target.joint] == limb]
        positions = _bent(positions, limb, _shift(positions, own, motion))
    return dataclasses.replace(motion, positions=positions.astype(np.float32), codes=None)  # it is between codes


def _shift(positions: Clip, targets: Sequence[Target], motion: Motion) -> Float[np.ndarray, "T 3"]:
    """Returns how far to move the joints of targets in each frame."""
    wanted = {}
    for target in targets:
        for frame in np.minimum(target.frames(motion.fps), len(positions) - 1):
            wanted[int(frame)] = _way(positions[frame], target, motion.skeleton)
    return faded(wanted, len(positions), fade=round(FADE_SECONDS * motion.fps))


def _way(pose: Float[np.ndarray, "J 3"], target: Target, skeleton: Skeleton) -> Float[np.ndarray, "3"]:
    """Returns the way from a joint to the place of its target."""
    if target.joint == ROOT:
        x, z = target.place
        return np.array([x, 0.0, z]) - pose[0] * GROUND
    place = np.array(target.place)
    if target.relative:
        ahead = unit_vectors(facing(pose[None], skeleton))[0]
        left = np.array([ahead[2], 0.0, -ahead[0]])
        place = pose[0] * GROUND + place[0] * left + place[1] * np.array([0.0, 1.0, 0.0]) + place[2] * ahead
    return place - pose[skeleton.joint_names.index(target.joint)]


def faded(wanted: Mapping[int, Float[np.ndarray, "3"]], num_frames: int, *, fade: int) -> Float[np.ndarray, "T 3"]:
    """Returns shifts that are as wanted in some frames, 0 far from them, and change smoothly between.

    Args:
        wanted: Shifts by frame.
        num_frames: Frames of the result.
        fade: Frames from 0 to a shift. Between two that are nearer than both of their fades, it goes directly.
    """
    if not wanted:
        return np.zeros((num_frames, 3))
    frames = sorted(wanted)
    keys = [(frames[0] - fade, np.zeros(3))]
    for before, after in itertools.pairwise([*frames, frames[-1] + 3 * fade]):
        keys.append((before, wanted[before]))
        if after - before > 2 * fade:
            keys += [(before + fade, np.zeros(3)), (after - fade, np.zeros(3))]
    times, shifts = (np.array(part, np.float64) for part in zip(*keys, strict=True))
    now = np.arange(num_frames)
    place = np.clip(np.searchsorted(times, now, side="right") - 1, 0, len(times) - 2)
    # Before the first shift and after the last, the value is 0 and stays so.
    share = np.clip((now - times[place]) / (times[place + 1] - times[place]), 0, 1)
    return shifts[place] + (0.5 - 0.5 * np.cos(np.pi * share))[:, None] * (shifts[place + 1] - shifts[place])


def _bent(positions: Clip, limb: Limb, shift: Float[np.ndarray, "T 3"]) -> Clip:
    """Returns positions in which the end of a limb is moved by a shift."""
    start, hinge, end, toe = (jnp.asarray(positions[:, joint], jnp.float32) for joint in limb)
    way = jnp.asarray(shift, jnp.float32)
    bends = reaching_bends(start, hinge, end, way)
    moved = np.stack(move_foot(start, hinge, end, toe, way, bends), axis=1)
    result = positions.copy()
    result[:, list(limb[1:])] = np.where((shift != 0).any(axis=1)[:, None, None], moved, positions[:, list(limb[1:])])
    return result
