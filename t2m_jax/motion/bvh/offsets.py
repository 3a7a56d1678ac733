"""What position channels of a BVH file mean: the place of a joint itself, or what is added to its OFFSET."""

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from t2m_jax.motion.bvh.hierarchy import Hierarchy
from t2m_jax.motion.kinematics import forward_kinematics, rest_positions

PositionRule = Literal["auto", "absolute", "add"]

NO_MOVE = 0.05
"""Channels whose median is less than this part of OFFSET are changes of it, for a figure that stays where it is."""
MUCH_LONGER = 1.2
"""A figure is along Z if it is so much longer there than along Y. With Z up, it is so without rotations, too."""
LOWEST = 0.05
"""Quantile of the heights of the lowest joints."""


def translations_from_channels(
    hierarchy: Hierarchy,
    channels: Float[np.ndarray, "T J 3"],
    moving: Bool[np.ndarray, "J 3"],
    rotations: Float[np.ndarray, "T J 3 3"],
    *,
    rule: PositionRule,
) -> Float[np.ndarray, "T J 3"]:
    """Returns the local position of each joint in the file's unit, from OFFSET and position channels.

    Args:
        hierarchy: The joints.
        channels: Values of the position channels, 0 for those that a joint does not have.
        moving: Which joints and axes have one.
        rotations: Rotation of each joint in its parent's frame.
        rule: Whether channels replace OFFSET or are added to it. "auto" decides for the root by its height, and for the
            other joints by whether most of them repeat their OFFSET.
    """
    offsets = np.broadcast_to(hierarchy.offsets, channels.shape)
    replaced = np.where(moving, channels, offsets)
    added = offsets + channels
    if rule != "auto":
        return replaced if rule == "absolute" else added
    placed = moving.all(axis=1) & np.any(hierarchy.offsets != 0, axis=1)
    trunk = trunk_of(hierarchy)
    inner = placed & (np.array(hierarchy.parents) >= 0)
    if inner[[joint for joint in range(len(inner)) if joint not in trunk]].any():
        # The channels repeat the OFFSET if those of most inner joints are nearer to it than to zero.
        from_zero = np.linalg.norm(channels[:, inner], axis=-1).mean(axis=0)
        from_offset = np.linalg.norm(channels[:, inner] - hierarchy.offsets[inner], axis=-1).mean(axis=0)
        if np.median(from_offset - from_zero) < 0:
            return replaced
        trunk = trunk[:1]
    for joint in trunk:
        if placed[joint] and _is_place(hierarchy, channels[:, joint], added, rotations, joint):
            added[:, joint] = replaced[:, joint]
    return added


def trunk_of(hierarchy: Hierarchy) -> list[int]:
    """Returns the joints from the root to the first with several children: those that carry the whole figure."""
    children = np.bincount([parent for parent in hierarchy.parents if parent >= 0], minlength=len(hierarchy.parents))
    return list(range(int(np.argmax(children > 1)) + 1))


def _is_place(
    hierarchy: Hierarchy,
    channels: Float[np.ndarray, "T 3"],
    translations: Float[np.ndarray, "T J 3"],
    rotations: Float[np.ndarray, "T J 3 3"],
    joint: int,
) -> bool:
    """Returns whether the channels of a joint that carries the figure are its place, and not a change of its OFFSET.

    Programs differ, and no field says it. OFFSET often is a place in the room, so only heights are compared.
    """
    still = translations.copy()
    still[:, joint] = 0.0
    pose = forward_kinematics(rotations, still.astype(np.float32), hierarchy.parents).positions
    rest = rest_positions(hierarchy.offsets, hierarchy.parents)
    up = 2 if _is_along_z(pose) and _is_along_z(rest[None]) else 1
    offset = float(hierarchy.offsets[joint, up])
    if offset == 0 or np.median(channels[:, up]) / offset < NO_MOVE:
        return False
    # Somebody who lies or jumps is far from the height of OFFSET, but with the right meaning the lowest joint is on the
    # floor.
    lowest = float(np.quantile(pose[..., up].min(axis=1) + channels[:, up], LOWEST))
    return abs(lowest) < abs(lowest + offset)


def _is_along_z(positions: Float[np.ndarray, "T J 3"]) -> bool:
    _, along_y, along_z = np.median(np.ptp(positions, axis=1), axis=0)
    return bool(along_z > MUCH_LONGER * along_y)
