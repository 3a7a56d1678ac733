"""Errors of joint positions."""

import chex
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from t2m_jax.masks import masked_mean

Positions = Float[Array, "B T J 3"]


def joint_errors(positions: Positions, reference: Positions) -> Float[Array, "B T"]:
    """Returns the mean distance of the joints in each frame after both roots are moved to the origin.

    The orientation is not aligned. The unit is that of the positions.
    """
    chex.assert_shape(positions, (None, None, None, 3))
    chex.assert_equal_shape([positions, reference])
    aligned = positions - positions[:, :, :1]
    aligned_reference = reference - reference[:, :, :1]
    return jnp.mean(jnp.linalg.norm(aligned - aligned_reference, axis=-1), axis=-1)


def aligned_joint_errors(positions: Positions, reference: Positions) -> Float[Array, "B T"]:
    """Returns the mean distance of the joints in each frame after the best rotation, scale and shift of the pose.

    This is the Procrustes alignment without reflection.
    """
    chex.assert_shape(positions, (None, None, None, 3))
    chex.assert_equal_shape([positions, reference])
    centered = positions - jnp.mean(positions, axis=2, keepdims=True)
    target = reference - jnp.mean(reference, axis=2, keepdims=True)
    left, strengths, right = jnp.linalg.svd(jnp.einsum("btji,btjk->btik", centered, target))
    signs = jnp.sign(jnp.linalg.det(left) * jnp.linalg.det(right))
    # Without the sign, the nearest rotation of a pose could be a reflection.
    strengths = strengths.at[..., -1].multiply(signs)
    left = left.at[..., -1].multiply(signs[..., None])
    scale = jnp.sum(strengths, axis=-1) / jnp.maximum(jnp.sum(centered**2, axis=(2, 3)), 1e-12)
    turned = jnp.einsum("btji,btik->btjk", centered, left @ right) * scale[..., None, None]
    return jnp.mean(jnp.linalg.norm(turned - target, axis=-1), axis=-1)


def mpjpe(positions: Positions, reference: Positions, mask: Bool[Array, "B T"]) -> Float[Array, ""]:
    """Returns the root-aligned mean per-joint position error over the True frames (as MoMask's evaluation does)."""
    chex.assert_equal_shape_prefix([positions, mask], 2)
    return masked_mean(joint_errors(positions, reference), mask)


def pa_mpjpe(positions: Positions, reference: Positions, mask: Bool[Array, "B T"]) -> Float[Array, ""]:
    """Returns the mean per-joint position error over the True frames with every pose aligned by Procrustes."""
    chex.assert_equal_shape_prefix([positions, mask], 2)
    return masked_mean(aligned_joint_errors(positions, reference), mask)
