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


def mpjpe(positions: Positions, reference: Positions, mask: Bool[Array, "B T"]) -> Float[Array, ""]:
    """Returns the root-aligned mean per-joint position error over the True frames (as MoMask's evaluation does)."""
    chex.assert_equal_shape_prefix([positions, mask], 2)
    return masked_mean(joint_errors(positions, reference), mask)
