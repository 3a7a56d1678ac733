"""A filter over time that takes trembling out of a clip and leaves its movement."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from t2m_jax.motion.features import gaussian_kernel


def smooth_over_clip(
    positions: Float[Array, "T J 3"], length: Int[Array, ""], *, sigma: float
) -> Float[Array, "T J 3"]:
    """Returns positions without movement that is faster than bodies move.

    The kernel is 1 - (1 - g) * (1 - g) * (1 - g) with a Gaussian g, which leaves slow movement as it is. A clip
    continues beyond its ends as it was before, mirrored at the end point, so that its speed remains.

    Args:
        positions: One clip and padding.
        length: Frames of the clip.
        sigma: Standard deviation of the Gaussian in frames.
    """
    rest = -gaussian_kernel(sigma)
    rest[len(rest) // 2] += 1.0
    kernel = -np.convolve(np.convolve(rest, rest), rest)
    reach = len(kernel) // 2
    kernel[reach] += 1.0
    wanted = jnp.arange(-reach, len(positions) + reach)
    inside = jnp.clip(wanted, 0, length - 1)
    mirrored = jnp.clip(2 * inside - wanted, 0, length - 1)
    beyond = (wanted != inside)[:, None, None]
    longer = positions[inside] + jnp.where(beyond, positions[inside] - positions[mirrored], 0.0)
    # Row t of the matrix has the kernel around frame t.
    steps = np.arange(len(wanted))[None] - np.arange(len(positions))[:, None]
    matrix = np.where((steps >= 0) & (steps < len(kernel)), kernel[np.clip(steps, 0, len(kernel) - 1)], 0.0)
    return jnp.einsum("ts,sjc->tjc", jnp.asarray(matrix, jnp.float32), longer)
