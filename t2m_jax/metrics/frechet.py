"""The Fréchet distance of two sets of embeddings (FID; Heusel et al. 2017, equation 6), right in float32.

The usual form, tr(S1) + tr(S2) - 2 tr sqrt(S1 S2), takes a small difference of large numbers, and an eigendecomposition
in float32 is off by a tenth at 512 dimensions. With S1 = A'A and S2 = B'B the same number is the least |A - QB|^2 over
all rotations and reflections Q (orthogonal Procrustes): a sum of squares, in which nothing cancels.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

HIGHEST = jax.lax.Precision.HIGHEST
"""Accelerators would round the factors of a product to 10 bits otherwise."""


def covariance_factor(embeddings: Float[Array, "N D"]) -> Float[Array, "D D"]:
    """Returns a triangular factor R of the unbiased covariance, R'R, with rows of zeros where samples are few."""
    centred = (embeddings - jnp.mean(embeddings, axis=0, keepdims=True)) / jnp.sqrt(len(embeddings) - 1.0)
    factor = jnp.linalg.qr(centred, mode="r")
    return jnp.pad(factor, ((0, embeddings.shape[1] - factor.shape[0]), (0, 0)))


def fid(real: Float[Array, "N D"], generated: Float[Array, "M D"]) -> Float[Array, ""]:
    """Returns the squared Fréchet distance of the normal distributions with the sets' means and covariances.

    Raises:
        ValueError: if a set has fewer than two samples.
    """
    if min(len(real), len(generated)) < 2:
        raise ValueError("a covariance needs two samples or more")
    ours, theirs = covariance_factor(real), covariance_factor(generated)
    left, _, right = jnp.linalg.svd(jnp.matmul(ours, theirs.T, precision=HIGHEST))
    turned = jnp.matmul(jnp.matmul(left, right, precision=HIGHEST), theirs, precision=HIGHEST)
    shift = jnp.mean(real, axis=0) - jnp.mean(generated, axis=0)
    return jnp.sum(shift**2) + jnp.sum((ours - turned) ** 2)
