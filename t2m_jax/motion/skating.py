"""A measure of sliding feet that has a gradient."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from t2m_jax.motion.cleanup import CONTACT_HEIGHT, floor_height
from t2m_jax.motion.skeleton import Skeleton

STANDING_SPEED = 0.4
"""Feet that stand may be so fast; m/s."""
FLOOR_BLUR = 0.01
"""Feet count less within about so many meters of the height of contacts, so that lifting them helps, too."""


def skating(
    positions: Float[Array, "T J 3"], before: Float[Array, "T J 3"], frames: Bool[Array, " T"], skeleton: Skeleton
) -> Float[Array, ""]:
    """Returns how fast feet are that are low over the floor of the motion before: slow or lifted, they cost nothing."""
    feet = np.array(skeleton.left_foot + skeleton.right_foot)
    floor = floor_height(jnp.where(frames[:, None], before[:, feet, 1], jnp.inf), len(feet) * frames.sum())
    low = jax.nn.sigmoid((floor + CONTACT_HEIGHT - positions[:, feet, 1]) / FLOOR_BLUR) * frames[:, None]
    steps = jnp.sum(jnp.square(jnp.diff(positions[:, feet, ::2], axis=0)), axis=-1) * skeleton.fps**2
    speeds = jnp.sqrt(steps + 1e-6)  # the root of 0 has no gradient
    too_fast = jnp.square(jax.nn.relu(speeds - STANDING_SPEED))
    return jnp.sum(low[1:] * low[:-1] * too_fast) / jnp.maximum(frames.sum(), 1)
