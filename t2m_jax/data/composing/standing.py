"""Motions of standing still, which are cut out of clips."""

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.skeleton import HUMANML3D

STAND = "stand"
STILL_SPEED = 0.5
"""Meters per second of the fastest joint of a person who stands nearly still."""
QUIET_SPEED = 0.15
"""Speed to which such a stretch is slowed down."""
HANDS_DOWN = -0.3
"""Meters above the shoulder that a wrist stays below while a person stands still."""
SHORTEST_STAND = 8
"""Frames of the shortest stretch of stillness that is used."""
STAND_FRAMES = (30, 120)
"""Shortest and longest motion of standing still; stretches are played forward and backward until it is full."""


def find_stillness(positions: Float[np.ndarray, "T J 3"]) -> slice | None:
    """Returns the longest stretch in which a person stands still with low hands; None if it is too short."""
    names = HUMANML3D.joint_names
    wrists, shoulders = (
        positions[:, [names.index(f"{side}_{joint}") for side in ("left", "right")], 1]
        for joint in ("wrist", "shoulder")
    )
    speed = np.linalg.norm(np.diff(positions, axis=0, prepend=positions[:1]), axis=-1).max(axis=1) * HUMANML3D.fps
    still = (speed < STILL_SPEED) & np.all(wrists - shoulders < HANDS_DOWN, axis=1)
    # Where stillness begins and where it ends, in turn; the added ends close a stretch at an edge of the clip.
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    stretches = sorted((last - first, first) for first, last in zip(edges[::2], edges[1::2], strict=True))
    if not stretches or stretches[-1][0] < SHORTEST_STAND:
        return None
    length, first = stretches[-1]
    return slice(int(first), int(first + length))


def stand_still(positions: Float[np.ndarray, "T J 3"], *, num_frames: int) -> Float[np.ndarray, "U J 3"]:
    """Returns a stretch of stillness, played slowly forward and backward until it has `num_frames` frames."""
    last = len(positions) - 1
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=-1).max() * HUMANML3D.fps
    places = np.arange(num_frames) * min(1.0, QUIET_SPEED / max(speed, QUIET_SPEED))
    # To the last frame and back again, without a jump.
    places = last - np.abs(places % (2 * last) - last)
    before = np.minimum(places.astype(int), last - 1)
    share = (places - before).astype(np.float32)[:, None, None]
    return positions[before] * (1 - share) + positions[before + 1] * share
