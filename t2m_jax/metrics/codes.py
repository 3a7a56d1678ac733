"""How much of a codebook is used."""

import chex
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

Counts = Int[Array, "*R K"] | Float[Array, "*R K"]
"""How often each code was chosen; running averages of counts are not whole numbers."""


def code_usage(code_counts: Counts) -> Float[Array, "*R"]:
    """Returns the share of codes that were chosen at least once."""
    chex.assert_axis_dimension_gteq(code_counts, -1, 1)
    return jnp.mean((code_counts > 0).astype(jnp.float32), axis=-1)


def perplexity(code_counts: Counts) -> Float[Array, "*R"]:
    """Returns exp of the entropy of code use: K if all codes are used equally, 1 if only one is used or none."""
    chex.assert_axis_dimension_gteq(code_counts, -1, 1)
    total = jnp.sum(code_counts, axis=-1, keepdims=True)
    share = code_counts / jnp.where(total > 0, total, 1)
    # The inner `where` keeps log(0) out, because 0 * log(0) is NaN.
    return jnp.exp(-jnp.sum(share * jnp.log(jnp.where(share > 0, share, 1.0)), axis=-1))
