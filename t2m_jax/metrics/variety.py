"""How much motions differ: over a set, and among those of one caption. Pairs are given, so nothing is random here."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int


def diversity(embeddings: Float[Array, "N E"], pairs: Int[Array, "P 2"]) -> Float[Array, ""]:
    """Returns the mean distance of the given pairs of samples."""
    differences = embeddings[pairs[:, 0]] - embeddings[pairs[:, 1]]
    return jnp.mean(jnp.sqrt(jnp.sum(differences**2, axis=-1)))


def multimodality(embeddings: Float[Array, "Q S E"], pairs: Int[Array, "P 2"]) -> Float[Array, ""]:
    """Returns the mean distance of the given pairs among the S samples of each caption, the same pairs for all."""
    differences = embeddings[:, pairs[:, 0]] - embeddings[:, pairs[:, 1]]
    return jnp.mean(jnp.sqrt(jnp.sum(differences**2, axis=-1)))
