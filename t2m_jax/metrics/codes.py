"""How much of a codebook is used."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int


def code_usage(code_counts: Int[Array, " K"]) -> Float[Array, ""]:
    """Returns the share of codes that were chosen at least once."""
    return jnp.mean((code_counts > 0).astype(jnp.float32))


def perplexity(code_counts: Int[Array, " K"]) -> Float[Array, ""]:
    """Returns exp of the entropy of code use: K where all are used alike, 1 where one is used alone."""
    share = code_counts / jnp.maximum(jnp.sum(code_counts), 1)
    return jnp.exp(-jnp.sum(jnp.where(share > 0, share * jnp.log(jnp.where(share > 0, share, 1.0)), 0.0)))
