"""The variety of motions: in a set, and among the motions of one caption. The pairs to compare are arguments."""

import chex
import jax.numpy as jnp
from jaxtyping import Array, Float, Int


def diversity(embeddings: Float[Array, "N E"], pairs: Int[Array, "P 2"]) -> Float[Array, ""]:
    """Returns the mean distance of the given pairs of samples."""
    chex.assert_rank(embeddings, 2)
    chex.assert_shape(pairs, (None, 2))
    differences = embeddings[pairs[:, 0]] - embeddings[pairs[:, 1]]
    return jnp.mean(jnp.sqrt(jnp.sum(differences**2, axis=-1)))


def multimodality(embeddings: Float[Array, "Q S E"], pairs: Int[Array, "P 2"]) -> Float[Array, ""]:
    """Returns the mean distance of the given pairs of samples of a caption. All captions use the same pairs."""
    chex.assert_rank(embeddings, 3)
    chex.assert_shape(pairs, (None, 2))
    differences = embeddings[:, pairs[:, 0]] - embeddings[:, pairs[:, 1]]
    return jnp.mean(jnp.sqrt(jnp.sum(differences**2, axis=-1)))
