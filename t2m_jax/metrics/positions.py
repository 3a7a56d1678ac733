"""Errors of joint positions."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def joint_errors(positions: Float[Array, "B T J 3"], reference: Float[Array, "B T J 3"]) -> Float[Array, "B T"]:
    """Returns the mean distance of the joints in each frame after both roots were moved to the origin.

    Orientation is not aligned. Unit: that of the positions.
    """
    aligned = positions - positions[:, :, :1]
    aligned_reference = reference - reference[:, :, :1]
    return jnp.mean(jnp.linalg.norm(aligned - aligned_reference, axis=-1), axis=-1)


def mpjpe(
    positions: Float[Array, "B T J 3"], reference: Float[Array, "B T J 3"], mask: Bool[Array, "B T"]
) -> Float[Array, ""]:
    """Returns the root-aligned mean per-joint position error over the True frames (as MoMask's evaluation does)."""
    errors = jnp.where(mask, joint_errors(positions, reference), 0.0)
    return jnp.sum(errors) / jnp.maximum(jnp.sum(mask), 1)
