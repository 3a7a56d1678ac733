"""Moving the foot of a leg whose hip stays: the knee bends as needed, but it does not snap straight."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

LEAST_SLACK = 0.25
"""Share that stays of what a leg is shorter than a straight one, however far its foot is moved away. The knee bends by
the square root of it, so it keeps half of its angle and more."""
WINDOW_SECONDS = 0.1
"""A knee turns no faster than it did in this time before and after."""

Joint = Float[Array, "T 3"]
Frames = Bool[Array, " T"]
Bends = Float[Array, " T"]
"""By how much a knee is bent in each frame, in radians; 0 is a straight leg."""


def lengths_of(vectors: Float[Array, "*B C"]) -> Float[Array, "*B 1"]:
    """Returns lengths, at least 1e-6, so that they can be divided by."""
    return jnp.maximum(jnp.linalg.norm(vectors, axis=-1, keepdims=True), 1e-6)


def knee_bends(hip: Joint, knee: Joint, ankle: Joint) -> Bends:
    """Returns the bends of the knee of a leg."""
    return _bends(lengths_of(knee - hip), lengths_of(ankle - knee), lengths_of(ankle - hip))


def reaching_bends(hip: Joint, knee: Joint, ankle: Joint, shift: Joint) -> Bends:
    """Returns the bends of a knee whose foot moves by a shift, as far as a straight leg reaches."""
    return _bends(lengths_of(knee - hip), lengths_of(ankle - knee), lengths_of(ankle + shift - hip))


def eased_bends(hip: Joint, knee: Joint, ankle: Joint, shift: Joint) -> Bends:
    """Returns the bends of a knee whose foot moves by a shift.

    A nearly straight leg is longer by a centimeter only if its knee turns by 20 degrees. So the leg follows a foot that
    moves away at first, and then less and less, and the foot stays some millimeters short of its place.
    """
    thigh, shin, old = lengths_of(knee - hip), lengths_of(ankle - knee), lengths_of(ankle - hip)
    wanted = lengths_of(ankle + shift - hip)
    slack = jnp.maximum(thigh + shin - old, 1e-6)
    # An exponential, as in soft inverse kinematics: it begins with slope 1 and ends before the leg is straight.
    left = jnp.exp(-jnp.maximum(wanted - old, 0.0) / (slack * (1 - LEAST_SLACK)))
    farther = thigh + shin - slack * (LEAST_SLACK + (1 - LEAST_SLACK) * left)
    return _bends(thigh, shin, jnp.where(wanted > old, farther, wanted))


def move_foot(hip: Joint, knee: Joint, ankle: Joint, toe: Joint, shift: Joint, bends: Bends) -> tuple[Joint, ...]:
    """Returns knee, ankle and toe of a leg whose foot moves by a shift, as far as the bends of its knee allow."""
    thigh, shin = lengths_of(knee - hip), lengths_of(ankle - knee)
    reach = jnp.sqrt(jnp.maximum(thigh**2 + shin**2 + 2 * thigh * shin * jnp.cos(bends[:, None]), 1e-12))
    wanted = ankle + shift - hip
    direction = wanted / lengths_of(wanted)
    # The knee is on a circle around the line from hip to ankle, on the side on which it was.
    along = (thigh**2 - shin**2 + reach**2) / (2 * reach)
    side = (knee - hip) - jnp.sum((knee - hip) * direction, axis=-1, keepdims=True) * direction
    aside = jnp.sqrt(jnp.maximum(thigh**2 - along**2, 0.0)) * side / lengths_of(side)
    new_ankle = hip + reach * direction
    return hip + along * direction + aside, new_ankle, toe + new_ankle - ankle


def limit_speed(bends: Bends, before: Bends, mask: Frames, *, fps: float) -> Bends:
    """Returns bends near the given ones that change no faster than those before did within `WINDOW_SECONDS`.

    Bends that are slow enough are not changed. The others become the mean of two functions that are: the largest one
    that is nowhere above the bends, and the smallest one that is nowhere below them.

    Args:
        bends: Of a knee.
        before: Bends of the same knee in a motion in which it is as fast as it may be.
        mask: True in the frames of the clip, which come first.
        fps: Frames per second.
    """
    window = 2 * max(1, round(WINDOW_SECONDS * fps)) + 1
    changes = jnp.where(mask[1:], jnp.abs(jnp.diff(before)), 0.0)
    allowed = jax.lax.reduce_window(changes, 0.0, jax.lax.max, (window,), (1,), "SAME")
    # As far as a bend may change from the first frame to each: between two frames, it is the difference of these.
    far = jnp.append(0.0, jnp.cumsum(allowed))
    high, low = jnp.where(mask, bends, jnp.inf), jnp.where(mask, bends, -jnp.inf)
    below = jnp.minimum(jax.lax.cummin(high - far) + far, jax.lax.cummin(high + far, reverse=True) - far)
    above = jnp.maximum(jax.lax.cummax(low + far) - far, jax.lax.cummax(low - far, reverse=True) + far)
    return (below + above) / 2


def _bends(thigh: Float[Array, "T 1"], shin: Float[Array, "T 1"], reach: Float[Array, "T 1"]) -> Bends:
    """Returns the bends of a knee if the ankle is this far from the hip."""
    return jnp.arccos(jnp.clip((reach**2 - thigh**2 - shin**2) / (2 * thigh * shin), -1.0, 1.0))[:, 0]
