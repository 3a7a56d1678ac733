"""Masks: True where there is data."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


def mask_from_lengths(lengths: Int[Array, " B"], size: int) -> Bool[Array, "B {size}"]:
    """Returns a mask that is True at the first `lengths[b]` positions of row b."""
    return jnp.arange(size)[None, :] < lengths[:, None]


def masked_mean(values: Float[Array, "..."], mask: Bool[Array, "..."]) -> Float[Array, ""]:
    """Returns the mean of `values` over the True positions of `mask`, or 0 if there are none."""
    mask = jnp.broadcast_to(mask, values.shape)
    # `where` and not a product: values outside the mask may be infinite or NaN.
    return jnp.sum(jnp.where(mask, values, 0.0)) / jnp.maximum(jnp.sum(mask), 1)
