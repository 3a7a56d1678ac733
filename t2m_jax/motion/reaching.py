"""Bringing a motion exactly to targets: its direction, its root, its pose, and its wrists and feet.

The body turns about its root, and moves over the ground with it. Bones turn into a pose. A limb of two bones bends as
needed, by inverse kinematics. All begin before the time of a target and end after it, so that nothing jumps, and bones
keep their lengths.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from t2m_jax.motion.features import bone_vectors, facing, positions_from_bones
from t2m_jax.motion.inertialization import pose_change, with_bones_of
from t2m_jax.motion.joining import place_positions
from t2m_jax.motion.legs import move_foot, reaching_bends
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.motion.targets import FACING, POSE, ROOT, Target, facing_degrees

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
    """Returns what an exact target may be about: root, direction, pose, and the ends of limbs."""
    return [ROOT, FACING, POSE, *limbs_of(skeleton)]


def check_exact(targets: Sequence[Target], skeleton: Skeleton) -> None:
    """Raises `UserError` if a target is exact and about a joint that no limb can bring to its place."""
    known = exact_joints(skeleton)
    for target in targets:
        if target.exact and target.joint not in known:
            raise target.error(f"cannot be exact; these can: {', '.join(known)}")


def reach_exactly(motion: Motion, targets: Sequence[Target]) -> Motion:
    """Returns a motion that meets those targets that are exact, as far as its bones reach."""
    exact = [target for target in targets if target.exact]
    if not exact:
        return motion
    limbs = limbs_of(motion.skeleton)
    positions = motion.positions.astype(np.float64)
    poses = _about([POSE], exact)
    # Each step is before those that it would undo.
    if poses:
        positions = _shaped(positions, poses, motion)
    if turns := _about([FACING], exact):
        positions = _turned(positions, turns, motion)
    if roots := _about([ROOT], exact):
        positions = positions + _shift(positions, roots, motion)[:, None]
    if poses:
        positions = _posed(positions, poses, motion)
    for limb in dict.fromkeys(limbs.values()):
        if ends := _about([name for name, own in limbs.items() if own == limb], exact):
            positions = _bent(positions, limb, _shift(positions, ends, motion))
    return dataclasses.replace(motion, positions=positions.astype(np.float32), codes=None)  # it is between codes


def _about(joints: Sequence[str], targets: Sequence[Target]) -> list[Target]:
    return [target for target in targets if target.joint in joints]


def _frames(target: Target, motion: Motion) -> list[int]:
    """Returns the frames in which a target holds; after the end of the motion, its last frame."""
    return [min(frame, motion.num_frames - 1) for frame in target.frames(motion.fps)]


def _faded(wanted: Mapping[int, Float[np.ndarray, " C"]], motion: Motion) -> Float[np.ndarray, "T C"]:
    return faded(wanted, motion.num_frames, fade=round(FADE_SECONDS * motion.fps))


def _turned(positions: Clip, targets: Sequence[Target], motion: Motion) -> Clip:
    """Returns positions turned about the root, so that the figure faces where targets say."""
    from scipy.spatial.transform import Rotation  # here, because it takes long to import

    now = facing_degrees(positions, motion.skeleton)
    # The shorter way around.
    wanted = {
        frame: np.array([0.0, (target.place[0] - now[frame] + 180) % 360 - 180, 0.0])
        for target in targets
        for frame in _frames(target, motion)
    }
    turns = Rotation.from_rotvec(_faded(wanted, motion), degrees=True).as_matrix()
    root = positions[:, :1]
    return root + np.einsum("tab,tjb->tja", turns, positions - root)


def _shaped(positions: Clip, targets: Sequence[Target], motion: Motion) -> Clip:
    """Returns positions with pelvis and chest as in the poses of targets, which turns alone could not meet."""
    ends = [choose(targets, key=lambda target: target.seconds) for choose in (min, max)]
    poses = np.concatenate([_pose_of(target, positions, motion) for target in ends])
    return with_bones_of(poses, positions, motion.skeleton)


def _posed(positions: Clip, targets: Sequence[Target], motion: Motion) -> Clip:
    """Returns positions whose bones turn into the poses of targets; pelvis and chest turn as one piece each."""
    from scipy.spatial.transform import Rotation  # here, because it takes long to import

    skeleton = motion.skeleton
    bones = bone_vectors(positions, skeleton)
    wanted = {}
    for target in targets:
        pose = _pose_of(target, positions, motion)
        for frame in _frames(target, motion):
            (goal,) = place_positions(pose, pose[0], positions[frame], skeleton=skeleton)
            change = pose_change(positions[frame], goal, skeleton)
            change[0] = [0.0, goal[0, 1] - positions[frame, 0, 1], 0.0]
            wanted[frame] = change.ravel()
    changes = _faded(wanted, motion).reshape(positions.shape)
    turned = Rotation.from_rotvec(changes[:, 1:].reshape(-1, 3)).apply(bones.reshape(-1, 3)).reshape(bones.shape)
    posed = positions_from_bones(positions[:, 0] + changes[:, 0], turned, skeleton)
    return np.where(np.any(changes, axis=(1, 2), keepdims=True), posed, positions)


def _pose_of(target: Target, positions: Clip, motion: Motion) -> Float[np.ndarray, "1 J 3"]:
    """Returns the pose of a target with bones as long as those of the motion."""
    assert target.pose is not None
    pose = target.pose[None].astype(np.float64)
    own = bone_vectors(positions[_frames(target, motion)[:1]], motion.skeleton)
    bones = unit_vectors(bone_vectors(pose, motion.skeleton)) * np.linalg.norm(own, axis=-1, keepdims=True)
    return positions_from_bones(pose[:, 0], bones, motion.skeleton)


def _shift(positions: Clip, targets: Sequence[Target], motion: Motion) -> Float[np.ndarray, "T 3"]:
    """Returns how far to move the joints of targets in each frame."""
    wanted = {}
    for target in targets:
        for frame in _frames(target, motion):
            wanted[frame] = _way(positions[frame], target, motion.skeleton)
    return _faded(wanted, motion)


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


def faded(wanted: Mapping[int, Float[np.ndarray, " C"]], num_frames: int, *, fade: int) -> Float[np.ndarray, "T C"]:
    """Returns changes that are as wanted in some frames, 0 far from them, and go smoothly from one to the next.

    Args:
        wanted: Changes by frame, at least one.
        num_frames: Frames of the result.
        fade: Frames from 0 to a change. Between two that are nearer than both of their fades, it goes directly.
    """
    frames = sorted(wanted)
    none = np.zeros_like(wanted[frames[0]])
    keys = [(frames[0] - fade, none)]
    for before, after in itertools.pairwise([*frames, frames[-1] + 3 * fade]):
        keys.append((before, wanted[before]))
        if after - before > 2 * fade:
            keys += [(before + fade, none), (after - fade, none)]
    times, changes = (np.array(part, np.float64) for part in zip(*keys, strict=True))
    now = np.arange(num_frames)
    place = np.clip(np.searchsorted(times, now, side="right") - 1, 0, len(times) - 2)
    # Before the first change and after the last, the value is 0 and stays so.
    share = np.clip((now - times[place]) / (times[place + 1] - times[place]), 0, 1)
    return changes[place] + (0.5 - 0.5 * np.cos(np.pi * share))[:, None] * (changes[place + 1] - changes[place])


def _bent(positions: Clip, limb: Limb, shift: Float[np.ndarray, "T 3"]) -> Clip:
    """Returns positions in which the end of a limb is moved by a shift."""
    start, hinge, end, toe = (jnp.asarray(positions[:, joint], jnp.float32) for joint in limb)
    way = jnp.asarray(shift, jnp.float32)
    bends = reaching_bends(start, hinge, end, way)
    moved = np.stack(move_foot(start, hinge, end, toe, way, bends), axis=1)
    result = positions.copy()
    result[:, list(limb[1:])] = np.where((shift != 0).any(axis=1)[:, None, None], moved, positions[:, list(limb[1:])])
    return result
