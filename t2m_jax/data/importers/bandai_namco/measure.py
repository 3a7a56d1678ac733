"""What can be measured in a clip and said in its captions: speed, turn, how high the hands go, how often they wave."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.skeleton import HUMANML3D, Skeleton

_UP = np.array([0.0, 1.0, 0.0])


class Facts(NamedTuple):
    """Measurements of one clip of the HumanML3D skeleton, positions in metres."""

    speed: float
    """metres a second: of the root over the ground while it travels, else the faster wrist (95th percentile)"""
    turn: float
    """degrees from the first heading to the last, counted through; positive to the actor's left"""
    travel: float
    """metres from the first place to the last, over the ground"""
    forward: float
    """metres travelled along the heading of each frame; negative when walking backwards"""
    leftward: float
    """metres travelled to the actor's own left"""
    above_head: tuple[float, float]
    """metres by which the left and the right wrist come above the head joint at their highest; negative when they do
    not"""
    above_shoulder: tuple[float, float]
    """the same against the shoulder of that side"""
    waves: int
    """sweeps of the more active wrist from side to side and back, counted against the shoulders"""


def heading_angles(positions: Float[np.ndarray, "T J 3"], skeleton: Skeleton = HUMANML3D) -> Float[np.ndarray, " T"]:
    """Returns the direction that hips and shoulders face, radians about +Y from +Z, without jumps of a full turn."""
    joints = {name: positions[:, index] for index, name in enumerate(skeleton.joint_names)}
    across = joints["left_hip"] - joints["right_hip"] + joints["left_shoulder"] - joints["right_shoulder"]
    forward = np.cross(across, _UP)
    return np.unwrap(np.arctan2(forward[:, 0], forward[:, 2]))


def _local_steps(positions: Float[np.ndarray, "T J 3"], headings: Float[np.ndarray, " T"]) -> Float[np.ndarray, "S 2"]:
    """Returns root steps in the body's frame: to the left, ahead (metres a frame)."""
    steps = np.diff(positions[:, 0, [0, 2]], axis=0)
    sine, cosine = np.sin(headings[:-1]), np.cos(headings[:-1])
    left = steps[:, 0] * cosine - steps[:, 1] * sine
    ahead = steps[:, 0] * sine + steps[:, 1] * cosine
    return np.stack([left, ahead], axis=1)


def _count_waves(sway: Float[np.ndarray, " T"], *, least: float = 0.06) -> int:
    """Returns how many times a coordinate goes there and back by at least `least` metres.

    A turning point counts once the coordinate has come back by `least`, so that trembling is not counted.
    """
    turns, rising, low, high = 0, None, sway[0], sway[0]
    for value in sway:
        low, high = min(low, value), max(high, value)
        if rising is not True and value > low + least:
            turns, rising, high = turns + (rising is False), True, value
        elif rising is not False and value < high - least:
            turns, rising, low = turns + (rising is True), False, value
    return turns // 2


def _highest(difference: Float[np.ndarray, "T 2 3"]) -> tuple[float, float]:
    """Returns the largest vertical component over time, left and right."""
    left, right = difference[:, :, 1].max(axis=0)
    return float(left), float(right)


def measure(positions: Float[np.ndarray, "T J 3"], *, fps: float, skeleton: Skeleton = HUMANML3D) -> Facts:
    """Returns the measurements of a clip of at least two frames."""
    names = skeleton.joint_names
    headings = heading_angles(positions, skeleton)
    steps = _local_steps(positions, headings)
    travel = float(np.linalg.norm(positions[-1, 0, [0, 2]] - positions[0, 0, [0, 2]]))
    wrists = positions[:, [names.index("left_wrist"), names.index("right_wrist")]]
    shoulders = positions[:, [names.index("left_shoulder"), names.index("right_shoulder")]]
    head = positions[:, [names.index("head")] * 2]
    hand_speed = np.linalg.norm(np.diff(wrists - positions[:, :1], axis=0), axis=-1) * fps
    path = float(np.sum(np.linalg.norm(steps, axis=1)))
    walking = path / len(steps) * fps > 0.3
    body_left = np.stack([np.cos(headings), np.zeros_like(headings), -np.sin(headings)], axis=-1)
    sway = np.einsum("twc,tc->wt", wrists - positions[:, :1], body_left)
    return Facts(
        speed=path / len(steps) * fps if walking else float(np.percentile(hand_speed.max(axis=1), 95)),
        turn=float(np.rad2deg(headings[-1] - headings[0])),
        travel=travel,
        forward=float(steps[:, 1].sum()),
        leftward=float(steps[:, 0].sum()),
        above_head=_highest(wrists - head),
        above_shoulder=_highest(wrists - shoulders),
        waves=max(_count_waves(line) for line in sway),
    )
