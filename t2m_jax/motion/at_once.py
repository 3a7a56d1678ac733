"""What legs do while arms do something else, by limits on the measurements of a clip.

Samples are chosen by them. Models are judged by other rules (`t2m_jax.evaluation.prompts`).
"""

import math
from collections.abc import Callable, Collection

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.facts import Facts
from t2m_jax.motion.repetitions import COUNTED_ACTIONS
from t2m_jax.motion.skeleton import JOINT

GAIT_SPEEDS = {"walk": (0.3, 2.0), "run": (1.2, math.inf)}
"""Slowest and fastest motion of a gait in m/s. People begin to run at about 2 m/s (Hreljac, 1993)."""
_AHEAD = 0.8
"""Smallest distance in meters ahead of somebody who goes."""
_STRAIGHT = 40.0
"""Largest change of heading in degrees of somebody who goes straight ahead."""
_CORNER = (50.0, 150.0)
"""Smallest and largest change of heading in degrees of somebody who turns a corner."""
_LOW_HAND = -0.2
"""Meters above its shoulder of the wrist of a hand that is not raised, at most."""
_LEAD = 0.15
"""Meters by which a raised hand comes higher than the other one, at least."""
_SHARE = 0.25
"""Of the time that a hand must be up."""
_LOW_FIST = -0.25
"""Meters above its shoulder of a wrist that punches, at least: arms that swing while walking reach as far."""
_BEATS = 2
"""Least waves, claps or punches."""


def _goes(gait: str, facts: Facts) -> bool:
    slowest, fastest = GAIT_SPEEDS[gait]
    return facts.forward >= _AHEAD and slowest <= facts.speed <= fastest


def _turns(turn: float, facts: Facts) -> bool:
    return facts.forward >= _AHEAD and _CORNER[0] <= turn <= _CORNER[1]


LEGS: dict[str, Callable[[Facts], bool]] = {
    "walk": lambda facts: _goes("walk", facts) and abs(facts.turn) <= _STRAIGHT,
    "run": lambda facts: _goes("run", facts) and abs(facts.turn) <= _STRAIGHT,
    "backward": lambda facts: facts.forward <= -_AHEAD,
    "left": lambda facts: _turns(facts.turn, facts),
    "right": lambda facts: _turns(-facts.turn, facts),
}
"""Whether somebody goes straight ahead at a gait, goes backward, or turns while going ahead."""


def arms_do(action: str, hands: Collection[str], positions: Float[np.ndarray, "T 22 3"]) -> float:
    """Returns how well arms do something, from 0 to 1.

    Hands that are up only for a moment, while the other hand is not low, get a third.

    Args:
        action: `clap`, `punch`, `raise` or `wave`.
        hands: Which are raised or wave: `left`, `right`, both of them, or none if any of them may.
        positions: The clip.
    """
    if action == "clap":
        return float(COUNTED_ACTIONS["clap"].count(positions) >= _BEATS)
    heights = {side: _wrist_heights(side, positions) for side in ("left", "right")}
    if action == "punch":
        return float(sum(_count_punches(side, positions, heights[side]) for side in heights) >= _BEATS)
    highest = {side: float(height.max()) for side, height in heights.items()}
    used = set(hands) or {max(highest, key=lambda side: highest[side])}
    # Somebody who is to raise one hand does not raise both, but arms swing in a run.
    other = max((highest[side] for side in highest.keys() - used if hands), default=-math.inf)
    lowest = min(highest[side] for side in used)
    is_up = lowest > max(0.0, other + _LEAD)
    if not is_up or (action == "wave" and COUNTED_ACTIONS["wave"].count(positions, used) < _BEATS):
        return 0.0
    is_long = all((heights[side] > 0).mean() >= _SHARE for side in used)
    return (1 + is_long + (other < _LOW_HAND)) / 3


def _wrist_heights(side: str, positions: Float[np.ndarray, "T 22 3"]) -> Float[np.ndarray, " T"]:
    """Returns how far a wrist is above its shoulder, in meters."""
    return (positions[:, JOINT[f"{side}_wrist"]] - positions[:, JOINT[f"{side}_shoulder"]])[:, 1]


def _count_punches(side: str, positions: Float[np.ndarray, "T 22 3"], heights: Float[np.ndarray, " T"]) -> int:
    peaks = COUNTED_ACTIONS["punch"].peaks(positions, [side])
    return int((heights[peaks] > _LOW_FIST).sum())
