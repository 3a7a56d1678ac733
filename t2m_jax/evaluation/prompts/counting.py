"""How often a motion shows an action, counted by the peaks of one curve per action.

It judges models, so it is not the rule by which training motions are counted, and samples chosen
(`motion.repetitions`).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.signal
from jaxtyping import Float

from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D, JOINT

SHORTEST_BEAT = 0.2
"""Seconds between two peaks that count as two."""
SHORTEST_THROW = 0.8
"""Seconds between two throws, each of which winds up first."""


Positions = Float[np.ndarray, "T J 3"]
Values = Float[np.ndarray, " T"]
Measure = Callable[[Positions], Values]


class Curve(NamedTuple):
    """What is measured in each frame of an action, in meters, and how its peaks count.

    The limits were chosen on real motion: people of Berkeley MHAD who repeat an action five times.
    """

    measure: Measure
    prominence: float
    """How far the curve must fall on both sides of a peak."""
    least: float = -np.inf
    """Lowest peak."""
    seconds: float = SHORTEST_BEAT
    """Shortest time between two peaks."""


def _height(name: str, *, sign: int = 1) -> Measure:
    """Returns a function that measures the height of a joint, or its depth with `sign` -1."""
    return lambda positions: sign * positions[:, JOINT[name], 1]


def _lower_hand(positions: Positions) -> Values:
    """Height of the lower wrist above its shoulder."""
    return np.min([_hand(side)(positions) for side in ("left", "right")], axis=0)


def _hand(side: str) -> Measure:
    return lambda positions: (positions[:, JOINT[f"{side}_wrist"]] - positions[:, JOINT[f"{side}_shoulder"]])[:, 1]


def _lower_foot(positions: Positions) -> Values:
    """Height of the lower foot. The pelvis would also rise after each landing."""
    return np.min([positions[:, JOINT[f"{side}_foot"], 1] for side in ("left", "right")], axis=0)


def _hand_speed(positions: Positions) -> Values:
    """Speed of the wrist that becomes faster, relative to the pelvis, in m/s."""
    wrists = [positions[:, JOINT[f"{side}_wrist"]] - positions[:, 0] for side in ("left", "right")]
    speeds = [np.linalg.norm(np.diff(wrist, axis=0, prepend=wrist[:1]), axis=1) for wrist in wrists]
    return max(speeds, key=np.max) * HUMANML3D.fps


def _feet_apart(positions: Positions) -> Values:
    feet = [positions[:, JOINT[f"{side}_ankle"], 1] for side in ("left", "right")]
    # Above the other foot, so that a jump is no kick.
    return np.abs(feet[0] - feet[1])


def _closeness(positions: Positions) -> Values:
    return -np.linalg.norm(positions[:, JOINT["left_wrist"]] - positions[:, JOINT["right_wrist"]], axis=1)


def _reach(side: str) -> Measure:
    """Returns a function that measures how far a wrist is from its shoulder over the ground."""

    def measure(positions: Positions) -> Values:
        arm = positions[:, JOINT[f"{side}_wrist"]] - positions[:, JOINT[f"{side}_shoulder"]]
        return np.linalg.norm(arm[:, [0, 2]], axis=1)

    return measure


def _sway(side: str) -> Measure:
    """Returns a function that measures how far a wrist is toward the other side, while it is raised."""

    def measure(positions: Positions) -> Values:
        other = "left" if side == "right" else "right"
        across = positions[:, JOINT[f"{other}_shoulder"]] - positions[:, JOINT[f"{side}_shoulder"]]
        across = across * [1.0, 0.0, 1.0]
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-6)
        sway = np.sum((positions[:, JOINT[f"{side}_wrist"]] - positions[:, 0]) * across, axis=1)
        # A hand on its way up or down does not wave.
        return np.where(_hand(side)(positions) > -0.05, sway, np.nan)

    return measure


CURVES: dict[str, tuple[Curve, ...]] = {
    "bow": (Curve(_height("head", sign=-1), 0.07),),
    "clap": (Curve(_closeness, 0.06, -0.25),),
    "hop": (Curve(_lower_foot, 0.05),),
    "jump": (Curve(_lower_foot, 0.08),),
    "jumping-jacks": (Curve(_lower_hand, 0.4, 0.0),),
    "kick": (Curve(_feet_apart, 0.25, 0.35),),
    "punch": (Curve(_reach("left"), 0.12, 0.35), Curve(_reach("right"), 0.12, 0.35)),
    "raise-up-both-hands": (Curve(_lower_hand, 0.3, -0.05),),
    "raise-up-left-hand": (Curve(_hand("left"), 0.3, -0.05),),
    "raise-up-right-hand": (Curve(_hand("right"), 0.3, -0.05),),
    "sit-down": (Curve(_height("pelvis", sign=-1), 0.2),),
    "squat": (Curve(_height("pelvis", sign=-1), 0.2),),
    "throw": (Curve(_hand_speed, 2.0, seconds=SHORTEST_THROW),),
    "wave-left-hand": (Curve(_sway("left"), 0.06),),
    "wave-right-hand": (Curve(_sway("right"), 0.06),),
}
"""The curves of each action that can be counted; the peaks of all of them are added up."""


def count_action(label: str, motion: Motion) -> int:
    """Returns how often a motion shows an action of `CURVES`.

    Args:
        label: The action.
        motion: Of the skeleton `HUMANML3D`, at its frame rate.
    """
    return sum(_count_peaks(curve, motion) for curve in CURVES[label])


def _count_peaks(curve: Curve, motion: Motion) -> int:
    values = curve.measure(np.asarray(motion.positions))
    if np.isnan(values).all():
        return 0
    values = np.where(np.isnan(values), np.nanmin(values), values)
    # A pose that is held to an end of the motion, such as sitting, is a peak, too.
    padded = np.pad(values, 1, constant_values=values.min())
    distance = max(1, round(curve.seconds * motion.fps))
    # A plateau counts once.
    peaks, _ = scipy.signal.find_peaks(padded, prominence=curve.prominence, distance=distance)
    return int(np.sum(padded[peaks] >= curve.least))
