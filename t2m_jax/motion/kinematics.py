"""Forward kinematics of any joint hierarchy."""

from collections.abc import Sequence
from typing import NamedTuple

import chex
import numpy as np
from jaxtyping import Float


class JointPoses(NamedTuple):
    """World position and rotation of each joint."""

    positions: Float[np.ndarray, "*batch J 3"]
    rotations: Float[np.ndarray, "*batch J 3 3"]


def forward_kinematics(
    rotations: Float[np.ndarray, "*batch J 3 3"], translations: Float[np.ndarray, "*batch J 3"], parents: Sequence[int]
) -> JointPoses:
    """Returns the world poses of a hierarchy of joints.

    Args:
        rotations: Rotation of each joint in its parent's frame.
        translations: Position of each joint in its parent's frame; the root's is its world position.
        parents: Parent of each joint, which must come before it; -1 for the root.
    """
    chex.assert_shape([rotations, translations], [(..., len(parents), 3, 3), (..., len(parents), 3)])
    # With the joint axis first, the matrices of a joint are contiguous, which is several times faster.
    local = np.moveaxis(np.asarray(rotations, np.float64), -3, 0)
    steps = np.moveaxis(np.asarray(translations, np.float64), -2, 0)
    world = np.empty(local.shape)
    positions = np.empty(steps.shape)
    for joint, parent in enumerate(parents):
        if parent < 0:  # a file may have several roots
            world[joint] = local[joint]
            positions[joint] = steps[joint]
            continue
        world[joint] = world[parent] @ local[joint]
        positions[joint] = positions[parent] + np.einsum("...ij,...j->...i", world[parent], steps[joint])
    return JointPoses(
        positions=np.moveaxis(positions, 0, -2).astype(np.float32),
        rotations=np.moveaxis(world, 0, -3).astype(np.float32),
    )


def rest_positions(offsets: Float[np.ndarray, "J 3"], parents: Sequence[int]) -> Float[np.ndarray, "J 3"]:
    """Returns the world positions of joints without any rotation."""
    still = np.broadcast_to(np.eye(3), (len(parents), 3, 3))
    return forward_kinematics(still, offsets, parents).positions


def line_to(joint: int, parents: Sequence[int]) -> list[int]:
    """Returns a joint and those above it, from the root."""
    line = [joint]
    while (parent := parents[line[-1]]) >= 0:
        line.append(parent)
    return line[::-1]


def rigid_rotations(
    rest: Float[np.ndarray, "N 3"], vectors: Float[np.ndarray, "*batch N 3"]
) -> Float[np.ndarray, "*batch 3 3"]:
    """Returns the rotations that bring the vectors `rest` closest to `vectors` by least squares (Kabsch 1976)."""
    chex.assert_shape(vectors, (..., *rest.shape))
    left, _, right = np.linalg.svd(np.einsum("...na,nb->...ab", np.asarray(vectors, np.float64), rest))
    # A reflection may fit better than any rotation. It is made a rotation by flipping the axis that matters least.
    signs = np.ones(left.shape[:-1])
    signs[..., 2] = np.sign(np.linalg.det(left) * np.linalg.det(right))
    return ((left * signs[..., None, :]) @ right).astype(np.float32)
