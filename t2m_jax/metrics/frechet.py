"""The Fréchet distance of two sets of embeddings (FID; Heusel et al. 2017, equation 6), accurate in float32.

The usual formula, tr(S1) + tr(S2) - 2 tr sqrt(S1 S2), is a small difference of large numbers. With a float32
eigendecomposition its error is about 10 % at 512 dimensions. With S1 = A'A and S2 = B'B, the same number is the least
value of |A - QB|^2 over all rotations and reflections Q (orthogonal Procrustes). Nothing cancels in a sum of squares.
"""

import chex
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

HIGHEST = jax.lax.Precision.HIGHEST
"""The default precision of accelerators rounds the factors of a product to 10 bits or fewer."""


def covariance_factor(embeddings: Float[Array, "N D"]) -> Float[Array, "D D"]:
    """Returns a triangular factor R of the unbiased covariance R'R. With few samples, the last rows are zero."""
    centered = (embeddings - jnp.mean(embeddings, axis=0, keepdims=True)) / jnp.sqrt(len(embeddings) - 1.0)
    factor = jnp.linalg.qr(centered, mode="r")
    return jnp.pad(factor, ((0, embeddings.shape[1] - factor.shape[0]), (0, 0)))


def fid(real: Float[Array, "N D"], generated: Float[Array, "M D"]) -> Float[Array, ""]:
    """Returns the squared Fréchet distance of the normal distributions with the sets' means and covariances.

    Raises:
        ValueError: A set has fewer than two samples.
    """
    chex.assert_rank([real, generated], 2)
    chex.assert_equal_shape_suffix([real, generated], 1)
    if min(len(real), len(generated)) < 2:
        raise ValueError("each set needs at least two samples")
    ours = covariance_factor(real)
    theirs = covariance_factor(generated)
    left, _, right = jnp.linalg.svd(jnp.matmul(ours, theirs.T, precision=HIGHEST))
    # The best Q is U V' of the singular vectors of A B': it turns B as near to A as possible.
    turned = jnp.matmul(jnp.matmul(left, right, precision=HIGHEST), theirs, precision=HIGHEST)
    shift = jnp.mean(real, axis=0) - jnp.mean(generated, axis=0)
    return jnp.sum(shift**2) + jnp.sum((ours - turned) ** 2)
