"""Joining clips of motion features at poses that match."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.skeleton import Skeleton

OVERLAP = 12
"""Frames in which one clip fades into the next."""
VELOCITY_SECONDS = 0.2
"""A difference of 1 m/s counts as much as a difference of this many meters."""


class Cut(NamedTuple):
    """Where two clips are joined."""

    end: int
    """Frames of the first clip, with the overlap."""
    start: int
    """First frame of the second clip, where the overlap begins."""
    cost: float
    """Mean distance of the joints in the middle of the overlap, in the skeleton's unit, and of their velocities."""


def find_cut(
    first: Float[np.ndarray, "T D"],
    second: Float[np.ndarray, "U D"],
    *,
    ends: range,
    starts: range,
    skeleton: Skeleton,
    overlap: int = OVERLAP,
) -> Cut:
    """Returns the cut at which two clips of raw features are most alike.

    Args:
        first: Clip that is joined to its beginning.
        second: Clip that follows.
        ends: Frames of the first clip that may be kept; at least `overlap`.
        starts: First frames of the second clip that may be used; `overlap` frames must follow.
        skeleton: Of both clips.
        overlap: Frames in which one fades into the other.
    """
    half = overlap // 2
    leaving = _poses(first, skeleton)[np.array(ends) - overlap + half]
    arriving = _poses(second, skeleton)[np.array(starts) + half]
    costs = np.linalg.norm(leaving[:, None] - arriving[None], axis=-1).mean(axis=-1)
    end, start = np.unravel_index(costs.argmin(), costs.shape)
    return Cut(ends[end], starts[start], float(costs[end, start]))


def _poses(features: Float[np.ndarray, "T D"], skeleton: Skeleton) -> Float[np.ndarray, "T J 6"]:
    """Returns each frame's joint positions and scaled velocities, relative to the root's heading."""
    layout, count = skeleton.layout, len(features)
    height = features[:, layout.root_height]
    root = np.concatenate([np.zeros_like(height), height, np.zeros_like(height)], axis=1)
    joints = np.concatenate([root[:, None], features[:, layout.positions].reshape(count, -1, 3)], axis=1)
    velocities = features[:, layout.velocities].reshape(count, -1, 3) * (skeleton.fps * VELOCITY_SECONDS)
    return np.concatenate([joints, velocities], axis=2)


def join_features(
    first: Float[np.ndarray, "T D"], second: Float[np.ndarray, "U D"], cut: Cut, *, overlap: int = OVERLAP
) -> Float[np.ndarray, "S D"]:
    """Returns raw features of one clip after another, T' = `cut.end` + U - `cut.start` - `overlap` frames.

    In the overlap, all features go smoothly from the first clip's to the second's. The root's velocity and turning
    speed are features, so path and heading continue without a jump. Bone lengths are not kept in the overlap:
    encode the joint positions of the result again.
    """
    share = (np.arange(overlap, dtype=np.float32) + 1) / (overlap + 1)
    share = (share**2 * (3 - 2 * share))[:, None]
    before, after = first[: cut.end], second[cut.start :]
    mixed = (1 - share) * before[cut.end - overlap :] + share * after[:overlap]
    return np.concatenate([before[: cut.end - overlap], mixed, after[overlap:]])


def fade_features(
    first: Float[np.ndarray, "T D"], second: Float[np.ndarray, "U D"], *, overlap: int
) -> tuple[Float[np.ndarray, "T D"], Float[np.ndarray, "U D"]]:
    """Returns raw features of two clips, the second of which follows the first, with all of their frames.

    In the `overlap` frames around the join, fewer if a clip is shorter, all features go smoothly from the first clip's
    to the second's. The first clip goes on with its last frame there, and the second one begins with its first frame.
    """
    half = min(overlap, len(first), len(second)) // 2
    if not half:
        return first, second
    before = np.pad(first[-half:], ((0, half), (0, 0)), mode="edge")
    after = np.pad(second[:half], ((half, 0), (0, 0)), mode="edge")
    mixed = join_features(before, after, Cut(2 * half, 0, 0.0), overlap=2 * half)
    return np.concatenate([first[:-half], mixed[:half]]), np.concatenate([mixed[half:], second[half:]])
