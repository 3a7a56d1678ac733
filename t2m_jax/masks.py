"""Masks: True where there is data."""

import chex
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.devices import global_sum


def mask_from_lengths(lengths: Int[Array, " B"], size: int) -> Bool[Array, "B {size}"]:
    """Returns a mask that is True at the first `lengths[b]` positions of row b."""
    chex.assert_rank(lengths, 1)
    return jnp.arange(size)[None, :] < lengths[:, None]


def masked_mean(values: Float[Array, "..."], mask: Bool[Array, "..."]) -> Float[Array, ""]:
    """Returns the mean of `values` over the True positions of `mask` on all devices, or 0 if there are none."""
    chex.assert_is_broadcastable(mask.shape, values.shape)
    mask = jnp.broadcast_to(mask, values.shape)
    # `where` and not a product: values outside the mask may be infinite or NaN.
    total, count = global_sum((jnp.sum(jnp.where(mask, values, 0.0)), jnp.sum(mask)))
    return total / jnp.maximum(count, 1)
