"""A common space of texts and motions, in which a text encoder learns to tell motions apart."""

import flax.linen as nn
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

WIDTH = 128
"""Of the space, and of the hidden layer for motions."""
EPSILON = 1e-6
"""Added to squares, so that their roots have gradients."""


class ContrastiveHead(nn.Module):
    """Maps text embeddings and motions to unit vectors. The vectors of a pair should be near each other.

    It is used in training alone. What it reads of a motion are mean and standard deviation of the code vectors, in the
    first and in the second half: how the body moves, and what comes first.
    """

    @nn.compact
    def __call__(
        self, text_embedding: Float[Array, "B E"], rows: Float[Array, "B N C"], mask: Bool[Array, "B N"]
    ) -> tuple[Float[Array, "B W"], Float[Array, "B W"]]:
        """Returns a vector for each text and each motion. The mask is True for the rows of a motion, its first ones."""
        is_first = 2 * jnp.arange(mask.shape[1])[None] < mask.sum(axis=1, keepdims=True)
        halves = (mask & is_first, mask & ~is_first)
        # Moments and not a recurrent network: the text encoder should learn, not this head.
        moments = jnp.concatenate([moment for half in halves for moment in _moments(rows, half)], axis=-1)
        hidden = nn.gelu(nn.Dense(WIDTH, name="motion_hidden")(nn.LayerNorm(name="motion_norm")(moments)))
        return _unit(nn.Dense(WIDTH, name="text")(text_embedding)), _unit(nn.Dense(WIDTH, name="motion")(hidden))


def _moments(rows: Float[Array, "B N C"], mask: Bool[Array, "B N"]) -> tuple[Float[Array, "B C"], Float[Array, "B C"]]:
    """Returns mean and standard deviation of the rows where the mask is True."""
    # A half of a motion of one row may be empty; its moments are zeros.
    weights = (mask / jnp.maximum(mask.sum(axis=1, keepdims=True), 1))[..., None].astype(rows.dtype)
    mean = jnp.sum(rows * weights, axis=1)
    variance = jnp.sum((rows - mean[:, None]) ** 2 * weights, axis=1)
    return mean, jnp.sqrt(variance + EPSILON)


def _unit(vectors: Float[Array, "B W"]) -> Float[Array, "B W"]:
    vectors = vectors.astype(jnp.float32)  # distances of unit vectors are too small for 16 bits
    return vectors / jnp.sqrt(jnp.sum(vectors**2, axis=-1, keepdims=True) + EPSILON)
