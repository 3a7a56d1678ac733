"""The torso of a cleaned clip: it trembles less, and pelvis and chest keep their shapes."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from t2m_jax.masks import mask_from_lengths
from t2m_jax.motion.legs import lengths_of
from t2m_jax.motion.namespace import AnyArray, namespace_of
from t2m_jax.motion.rotations import cross_product, matrix_from_quaternion, unit_vectors
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.motion.smoothing import smooth_over_clip

TORSO_SIGMA = 0.05
"""Standard deviation of the Gaussian that smooths the shape of the torso, which changes slowly; seconds."""
SQUARINGS = 16
"""Times that the matrix of a rotation is squared, and with it the share by which it is wrong. Collars are so near to
the line from the spine to the neck that 7 leave errors of tens of degrees, and 12 none."""
HINT = 0.005
"""Meters along the axes of the torso that are fitted together with a hub. They tell its turn if its bones are on a
line."""


def calm_torso(positions: Float[Array, "T J 3"], length: Int[Array, ""], skeleton: Skeleton) -> Float[Array, "T J 3"]:
    """Returns positions whose spine, hips and collars tremble less; limbs and head move along.

    Their bones are short, so an error of a few millimeters is a turn of several degrees. Seen from the torso, they turn
    slowly, so their directions are smoothed there.
    """
    torso = _torso(skeleton)
    ends, chains = bone_matrices(skeleton)
    bones = jnp.einsum("jb,tjc->tbc", ends, positions)
    frames = torso_frames(positions, skeleton)
    seen = jnp.einsum("tac,tbc->tba", frames, bones[:, torso])
    calm = smooth_over_clip(seen, length, sigma=TORSO_SIGMA * skeleton.fps)
    calm = calm * (lengths_of(seen) / lengths_of(calm))
    bones = bones.at[:, torso].set(jnp.einsum("tac,tba->tbc", frames, calm))
    return positions[:, :1] + jnp.einsum("jb,tbc->tjc", chains, bones)


def make_hubs_rigid(
    positions: Float[Array, "T J 3"], length: Int[Array, ""], skeleton: Skeleton
) -> Float[Array, "T J 3"]:
    """Returns positions whose pelvis and chest turn as one piece: hips and collars begin at fixed places on them.

    Formats with a rotation for each joint, such as BVH, can say nothing else. The shape is the mean over the clip.
    """
    ends, chains = bone_matrices(skeleton)
    bones = jnp.einsum("jb,tjc->tbc", ends, positions)
    share = mask_from_lengths(length[None], len(positions))[0] / length
    frames = torso_frames(positions, skeleton)
    axes = HINT * jnp.eye(3)
    fit = jax.jit(fitted_rotations)  # so that it is traced once and not twice

    def rigid(own: Float[Array, "T 3 3"]) -> Float[Array, "T 3 3"]:
        goals = jnp.concatenate([own, HINT * frames], axis=1)
        # Seen from the torso, the mean is nearly the shape; from the rotations that fit it best, it is the shape.
        shape = jnp.einsum("t,tac,tbc->ba", share, frames, own)
        shape = jnp.einsum("t,tca,tbc->ba", share, fit(jnp.concatenate([shape, axes]), goals), own)
        shape = shape * (lengths_of(own[0]) / lengths_of(shape))
        return jnp.einsum("tca,ba->tbc", fit(jnp.concatenate([shape, axes]), goals), shape)

    hubs = np.stack(hub_bones(skeleton))
    moved = jax.vmap(rigid, in_axes=1, out_axes=1)(bones[:, hubs])
    bones = bones.at[:, hubs.ravel()].set(moved.reshape(len(positions), -1, 3))
    kept = jnp.einsum("jb,tbc->tjc", chains, bones)
    # The root moves, too, so that the others move less.
    return kept + jnp.mean(positions - kept, axis=1, keepdims=True)


def torso_frames(positions: Float[AnyArray, "T J 3"], skeleton: Skeleton) -> Float[AnyArray, "T 3 3"]:
    """Returns the directions of the torso in each frame, as rows: from right to left, up along the spine, forward."""
    right_hip, left_hip, right_shoulder, left_shoulder = skeleton.face_joints
    across = (
        positions[:, left_hip] - positions[:, right_hip] + positions[:, left_shoulder] - positions[:, right_shoulder]
    )
    across = unit_vectors(across)
    up = positions[:, _spine(skeleton)[-2]] - positions[:, 0]
    xp = namespace_of(positions)
    up = unit_vectors(up - xp.sum(up * across, axis=-1, keepdims=True) * across)
    return xp.stack([across, up, cross_product(across, up)], axis=1)


def fitted_rotations(points: Float[Array, "N 3"], goals: Float[Array, "T N 3"]) -> Float[Array, "T 3 3"]:
    """Returns the rotations that bring points closest to their goals by least squares (Davenport 1968).

    The quaternion is the eigenvector of the largest eigenvalue of a symmetric matrix. Repeated squaring finds it with
    operations that can be exported, which a singular value decomposition is not.
    """
    products = jnp.einsum("tna,nb->tab", goals, points)
    trace = jnp.trace(products, axis1=1, axis2=2)[:, None, None]
    transposed = jnp.swapaxes(products, 1, 2)
    skew = products - transposed
    axis = jnp.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)[:, None]
    first = jnp.concatenate([trace, axis], axis=2)
    rest = jnp.concatenate([jnp.swapaxes(axis, 1, 2), products + transposed - trace * jnp.eye(3)[None]], axis=2)
    largest = jnp.sum(lengths_of(points)[None] * lengths_of(goals), axis=1, keepdims=True)
    # No eigenvalue is negative, so the largest one grows fastest.
    matrix = jnp.concatenate([first, rest], axis=1) + largest * jnp.eye(4)[None]

    def squared(_: Any, matrix: Float[Array, "T 4 4"]) -> Float[Array, "T 4 4"]:
        matrix = jnp.einsum("tab,tbc->tac", matrix, matrix)
        return matrix / jnp.trace(matrix, axis1=1, axis2=2)[:, None, None]

    # A loop, because it compiles in a fraction of the time that all rounds would take.
    matrix = jax.lax.fori_loop(0, SQUARINGS, squared, matrix)
    # A column of the matrix is a multiple of the quaternion. The longest is that of the largest entry of the diagonal.
    diagonal = jnp.sum(matrix * jnp.eye(4)[None], axis=2)
    longest = jax.nn.one_hot(jnp.argmax(diagonal, axis=1), 4)
    return matrix_from_quaternion(unit_vectors(jnp.einsum("tab,tb->ta", matrix, longest)))


def _spine(skeleton: Skeleton) -> tuple[int, ...]:
    """Returns the joints from above the pelvis to the head."""
    hips = skeleton.face_joints[:2]
    return next(chain for chain in skeleton.chains if chain[0] == 0 and chain[1] not in hips)[1:]


def _torso(skeleton: Skeleton) -> np.ndarray:
    """Returns the bones of hips, spine, head and shoulders."""
    shoulders = skeleton.face_joints[2:]
    collars = [skeleton.parents[shoulder] for shoulder in shoulders]
    return np.array(sorted({*skeleton.face_joints, *_spine(skeleton), *collars})) - 1


def hub_bones(skeleton: Skeleton) -> tuple[np.ndarray, ...]:
    """Returns the bones to the left, to the right and upwards of pelvis and chest.

    A chest at which arms begin without collars has no shape: shoulders can be raised.
    """
    right_hip, left_hip, right_shoulder, left_shoulder = skeleton.face_joints
    spine = _spine(skeleton)
    pelvis = (left_hip, right_hip, spine[0])
    left_collar, right_collar = skeleton.parents[left_shoulder], skeleton.parents[right_shoulder]
    chest = (left_collar, right_collar, spine[spine.index(skeleton.parents[left_collar]) + 1])
    hubs = [pelvis] if left_collar == right_collar else [pelvis, chest]
    return tuple(np.array(hub) - 1 for hub in hubs)


@functools.cache
def bone_matrices(skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Returns which bones end or begin at a joint, and which bones lead from the root to it; each [J, J-1]."""
    bones = np.arange(skeleton.num_joints - 1)
    ends = np.eye(skeleton.num_joints, dtype=np.float32)[:, 1:]
    chains = ends.copy()
    for bone in bones:
        chains[bone + 1] += chains[skeleton.parents[bone + 1]]
    ends[np.array(skeleton.parents[1:]), bones] -= 1
    return ends, chains
