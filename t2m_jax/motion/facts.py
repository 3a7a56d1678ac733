"""Measurements of a clip that captions mention: speed, turn, height of the hands, number of waves."""

from typing import NamedTuple

import chex
import numpy as np
from jaxtyping import Float

from t2m_jax.motion.features import facing
from t2m_jax.motion.skeleton import HUMANML3D, JOINT

WALKING_SPEED = 0.3
"""Meters per second of the root above which a clip counts as traveling."""
WAVE_WIDTH = 0.06
"""Meters that a wrist must come back before a turning point counts, so that trembling is not counted."""


class Facts(NamedTuple):
    """Measurements of one clip of the HumanML3D skeleton, positions in meters."""

    speed: float
    """Meters per second: of the root over the ground while it travels, else of the faster wrist (95th percentile)."""
    turn: float
    """Degrees from the first heading to the last, more than 360 for several turns; positive to the actor's left."""
    travel: float
    """Meters from the first place to the last, over the ground."""
    forward: float
    """Meters traveled along the heading of each frame; negative for walking backward."""
    above_head: tuple[float, float]
    """Largest height in meters of the left and the right wrist above the head joint; negative if they stay below it."""
    above_shoulder: tuple[float, float]
    """Largest height in meters of the left and the right wrist above the shoulder of the same side."""
    waves: int
    """Number of times that the more active wrist goes from side to side and back, relative to the body."""


def heading_angles(positions: Float[np.ndarray, "T 22 3"]) -> Float[np.ndarray, " T"]:
    """Returns the direction that hips and shoulders face, in radians about +Y from +Z, without jumps of a full turn."""
    ahead = facing(positions, HUMANML3D)
    return np.unwrap(np.arctan2(ahead[:, 0], ahead[:, 2]))


def _count_waves(sway: Float[np.ndarray, " T"]) -> int:
    """Returns the number of times that a coordinate (meters) goes there and back by at least `WAVE_WIDTH`."""
    turns = 0
    rising = None  # until it has moved far enough in one direction
    low = high = sway[0]
    for value in sway:
        low = min(low, value)
        high = max(high, value)
        if rising is not True and value > low + WAVE_WIDTH:
            turns += rising is False
            rising = True
            high = value
        elif rising is not False and value < high - WAVE_WIDTH:
            turns += rising is True
            rising = False
            low = value
    return turns // 2


def sways(positions: Float[np.ndarray, "T 22 3"], headings: Float[np.ndarray, " T"]) -> Float[np.ndarray, "2 T"]:
    """Returns how far the left and the right wrist are from the root to the actor's left, in meters."""
    wrists = positions[:, [JOINT[f"{side}_wrist"] for side in ("left", "right")]]
    body_left = np.stack([np.cos(headings), np.zeros_like(headings), -np.sin(headings)], axis=-1)
    return np.einsum("twc,tc->wt", wrists - positions[:, :1], body_left)


def measure(positions: Float[np.ndarray, "T 22 3"], *, fps: float) -> Facts:
    """Returns the measurements of a clip of at least two frames."""
    chex.assert_shape(positions, (None, HUMANML3D.num_joints, 3))
    root = positions[:, 0]
    headings = heading_angles(positions)
    wrists = positions[:, [JOINT["left_wrist"], JOINT["right_wrist"]]]
    shoulders = positions[:, [JOINT["left_shoulder"], JOINT["right_shoulder"]]]
    head = positions[:, [JOINT["head"]] * 2]
    # Steps of the root in the body's frame: to the left, ahead (meters per frame).
    x, z = np.diff(root[:, [0, 2]], axis=0).T
    sine = np.sin(headings[:-1])
    cosine = np.cos(headings[:-1])
    steps = np.stack([x * cosine - z * sine, x * sine + z * cosine], axis=1)
    speed = float(np.sum(np.linalg.norm(steps, axis=1))) / len(steps) * fps
    # Who stays in place may still be fast or slow with the hands.
    if speed <= WALKING_SPEED:
        hand_speed = np.linalg.norm(np.diff(wrists - positions[:, :1], axis=0), axis=-1) * fps
        speed = float(np.percentile(hand_speed.max(axis=1), 95))
    above_head, above_shoulder = ((wrists - joint)[:, :, 1].max(axis=0).tolist() for joint in (head, shoulders))
    return Facts(
        speed=speed,
        turn=float(np.rad2deg(headings[-1] - headings[0])),
        travel=float(np.linalg.norm(root[-1, [0, 2]] - root[0, [0, 2]])),
        forward=float(steps[:, 1].sum()),
        above_head=tuple(above_head),
        above_shoulder=tuple(above_shoulder),
        waves=max(_count_waves(line) for line in sways(positions, headings)),
    )
