"""Errors of joint positions."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

CONTACT_HEIGHT = 0.05
"""metres: a foot lower than this, over the lowest point of its clip, should not move"""


def joint_errors(positions: Float[Array, "B T J 3"], reference: Float[Array, "B T J 3"]) -> Float[Array, "B T"]:
    """Returns the mean distance of the joints in each frame after both roots were moved to the origin.

    Orientation is not aligned. Unit: that of the positions.
    """
    aligned = positions - positions[:, :, :1]
    aligned_reference = reference - reference[:, :, :1]
    return jnp.mean(jnp.linalg.norm(aligned - aligned_reference, axis=-1), axis=-1)


def aligned_joint_errors(positions: Float[Array, "B T J 3"], reference: Float[Array, "B T J 3"]) -> Float[Array, "B T"]:
    """Returns the mean distance of the joints in each frame after the best rotation, scale and shift of its pose.

    The alignment is Procrustes', without reflection.
    """
    centred = positions - jnp.mean(positions, axis=2, keepdims=True)
    target = reference - jnp.mean(reference, axis=2, keepdims=True)
    left, strengths, right = jnp.linalg.svd(jnp.einsum("btji,btjk->btik", centred, target))
    signs = jnp.sign(jnp.linalg.det(left) * jnp.linalg.det(right))
    strengths = strengths.at[..., -1].multiply(signs)
    left = left.at[..., -1].multiply(signs[..., None])
    scale = jnp.sum(strengths, axis=-1) / jnp.maximum(jnp.sum(centred**2, axis=(2, 3)), 1e-12)
    turned = jnp.einsum("btji,btik->btjk", centred, left @ right) * scale[..., None, None]
    return jnp.mean(jnp.linalg.norm(turned - target, axis=-1), axis=-1)


def _mean_over(errors: Float[Array, "B T"], mask: Bool[Array, "B T"]) -> Float[Array, ""]:
    return jnp.sum(jnp.where(mask, errors, 0.0)) / jnp.maximum(jnp.sum(mask), 1)


def mpjpe(
    positions: Float[Array, "B T J 3"], reference: Float[Array, "B T J 3"], mask: Bool[Array, "B T"]
) -> Float[Array, ""]:
    """Returns the root-aligned mean per-joint position error over the True frames (as MoMask's evaluation does)."""
    return _mean_over(joint_errors(positions, reference), mask)


def pa_mpjpe(
    positions: Float[Array, "B T J 3"], reference: Float[Array, "B T J 3"], mask: Bool[Array, "B T"]
) -> Float[Array, ""]:
    """Returns the mean per-joint position error over the True frames with every pose aligned by Procrustes."""
    return _mean_over(aligned_joint_errors(positions, reference), mask)


def acceleration_error(
    positions: Float[Array, "B T J 3"], reference: Float[Array, "B T J 3"], mask: Bool[Array, "B T"]
) -> Float[Array, ""]:
    """Returns the mean distance of the joints' second differences, over frames whose neighbours are data, too.

    Unit: that of the positions, a frame squared.
    """
    errors = jnp.linalg.norm(jnp.diff(positions - reference, n=2, axis=1), axis=-1)
    return _mean_over(jnp.mean(errors, axis=-1), mask[:, 2:] & mask[:, 1:-1] & mask[:, :-2])


def foot_skating(
    positions: Float[Array, "B T J 3"], mask: Bool[Array, "B T"], *, feet: tuple[int, ...], fps: float
) -> Float[Array, ""]:
    """Returns how fast feet on the ground slide, metres a second: the mean over frames and feet that touch it.

    Args:
        positions: Joints in metres, Y up.
        mask: True where there is data.
        feet: Joints that are feet.
        fps: Frames a second.
    """
    foot = positions[:, :, jnp.asarray(feet)]
    floor = jnp.min(jnp.where(mask[:, :, None], foot[..., 1], jnp.inf), axis=(1, 2), keepdims=True)
    low = (foot[..., 1] - floor < CONTACT_HEIGHT) & mask[:, :, None]
    touching = low[:, 1:] & low[:, :-1]
    speed = jnp.linalg.norm(jnp.diff(foot[..., jnp.array([0, 2])], axis=1), axis=-1) * fps
    return jnp.sum(jnp.where(touching, speed, 0.0)) / jnp.maximum(jnp.sum(touching), 1)
