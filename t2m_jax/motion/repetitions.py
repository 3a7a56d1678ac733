"""How often something is done in a motion: the peaks of a height, a distance or a reach."""

import itertools
from collections.abc import Callable, Collection
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.facts import heading_angles, sways
from t2m_jax.motion.skeleton import JOINT

SHARE = 0.4
"""Part of the range of a signal that a peak must have, so that the small swing after a jump does not count."""
APART = 0.3
"""Meters between the wrists from which on it does not matter how far apart they are."""
RAISED = -0.1
"""Meters of a wrist above its shoulder from which on the hand can wave."""

Positions = Float[np.ndarray, "T J 3"]
Signal = Float[np.ndarray, " T"]


def _height(positions: Positions, name: str) -> Signal:
    return positions[:, JOINT[name], 1]


def _arm(positions: Positions, side: str) -> Float[np.ndarray, "T 3"]:
    """Returns the wrist, seen from its shoulder."""
    return positions[:, JOINT[f"{side}_wrist"]] - positions[:, JOINT[f"{side}_shoulder"]]


def _reach(positions: Positions, side: str) -> Signal:
    """Returns how far a wrist is from its shoulder over the ground."""
    return np.linalg.norm(_arm(positions, side)[:, ::2], axis=-1)


def _sway(positions: Positions, side: str) -> Signal:
    """Returns how far inward a raised hand is, in meters; the least of them while it is not raised."""
    left, right = sways(positions, heading_angles(positions))
    inward = -left if side == "left" else right
    raised = _arm(positions, side)[:, 1] > RAISED
    return np.where(raised, inward, inward[raised].min(initial=inward.max()))


def _hands_meet(positions: Positions) -> Signal:
    apart = np.linalg.norm(positions[:, JOINT["left_wrist"]] - positions[:, JOINT["right_wrist"]], axis=-1)
    # Hanging arms are farther apart than hands between two claps, which would then be too small to count.
    return -np.minimum(apart, APART)


def _stride(positions: Positions) -> Signal:
    """Returns how far the ankles are apart over the ground."""
    return np.linalg.norm((positions[:, JOINT["left_ankle"]] - positions[:, JOINT["right_ankle"]])[:, ::2], axis=-1)


SIGNALS: dict[str, Callable[[Positions, str], Signal]] = {
    "rise": lambda positions, _: _height(positions, "pelvis"),
    "dip": lambda positions, _: -_height(positions, "pelvis"),
    "nod": lambda positions, _: _height(positions, "pelvis") - _height(positions, "head"),
    "foot": lambda positions, _: np.maximum(_height(positions, "left_ankle"), _height(positions, "right_ankle")),
    "both feet": lambda positions, _: np.minimum(_height(positions, "left_foot"), _height(positions, "right_foot")),
    "hands meet": lambda positions, _: _hands_meet(positions),
    "both wrists": lambda positions, _: np.minimum(_arm(positions, "left")[:, 1], _arm(positions, "right")[:, 1]),
    "reach": lambda positions, _: np.maximum(_reach(positions, "left"), _reach(positions, "right")),
    "own reach": _reach,
    "stride": lambda positions, _: _stride(positions),
    "wrist": lambda positions, side: _arm(positions, side)[:, 1],
    "sway": _sway,
}
"""What has a peak each time that something is done, in meters, of positions of the HumanML3D skeleton and a side."""
ONE_SIDED = frozenset({"own reach", "wrist", "sway"})
"""Signals that depend on the side."""


class Repetition(NamedTuple):
    """How an action is counted."""

    signal: str
    """Of `SIGNALS`."""
    least: float
    """Height of the smallest peak, in meters."""
    alternates: bool = False
    """Whether what one hand does counts beside what the other does: punches, but not arms that are raised together."""
    can_stop: bool = False
    """Whether a motion may end between two times: after a step or a jump, but not with a hand in the air."""

    def peaks(self, positions: Positions, sides: Collection[str] = ("left", "right")) -> list[int]:
        """Returns the frames at which it is done, by the hands of some sides if it is done with hands."""
        used = sorted(sides) if self.signal in ONE_SIDED else ["left"]
        found = [find_peaks(SIGNALS[self.signal](positions, side), least=self.least) for side in used]
        return sorted(itertools.chain.from_iterable(found)) if self.alternates else max(found, key=len)

    def count(self, positions: Positions, sides: Collection[str] = ("left", "right")) -> int:
        """Returns how often it is done."""
        return len(self.peaks(positions, sides))


_JUMP = Repetition("both feet", 0.05, can_stop=True)
_PUNCH = Repetition("own reach", 0.15, alternates=True)
_SIT = Repetition("dip", 0.2, can_stop=True)
_THROW = Repetition("reach", 0.3)
_RAISE = Repetition("wrist", 0.3)
_CLAP = Repetition("hands meet", 0.08)
COUNTED_ACTIONS: dict[str, Repetition] = {
    "applaud": _CLAP,
    "bounce": _JUMP,
    "bow": Repetition("nod", 0.15, can_stop=True),
    "box": _PUNCH,
    "clap": _CLAP,
    "crouch": _SIT,
    "hit": _PUNCH,
    "hop": _JUMP,
    "jab": _PUNCH,
    "jack": Repetition("both wrists", 0.3),
    "jump": _JUMP,
    "kick": Repetition("foot", 0.35, can_stop=True),
    "leap": _JUMP,
    "lift": _RAISE,
    "pitch": _THROW,
    "punch": _PUNCH,
    "put": _RAISE,
    "raise": _RAISE,
    "seat": _SIT,
    "sit": _SIT,
    "squat": _SIT,
    "step": Repetition("stride", 0.1, can_stop=True),
    "strike": _PUNCH,
    "throw": _THROW,
    "toss": _THROW,
    "wave": Repetition("sway", 0.06),
}
"""By basic forms of verbs. The limits count five times for most people of Berkeley MHAD who do something five times."""


SIDED_ACTIONS: dict[str, Callable[[Positions, str], Signal]] = {
    "kick": lambda positions, side: _height(positions, f"{side}_ankle"),
    "pitch": _reach,
    "throw": _reach,
    "toss": _reach,
}
"""What is larger for the leg or arm that does something, in meters, by basic forms of verbs."""


def side_lead(action: str, side: str, positions: Positions) -> float:
    """Returns by how many meters one side does an action more than the other; negative if it does it less."""
    signal = SIDED_ACTIONS[action]
    other = "left" if side == "right" else "right"
    return float(signal(positions, side).max() - signal(positions, other).max())


def find_peaks(values: Float[np.ndarray, " T"], *, least: float) -> list[int]:
    """Returns the frames of the peaks of a signal that stand out by `least`, and are not much smaller than others."""
    size = max(least, SHARE * float(np.ptp(values)))
    peaks = []
    # A peak counts when the signal has come up to it and goes down from it, so that it may be flat. One at an end of
    # the clip counts by its one flank.
    low = float(values.min())
    high = -np.inf
    place = 0
    rising = True
    for frame, value in enumerate(map(float, values)):
        if rising and value > high:
            high = value
            place = frame
        elif rising and value < high - size:
            if high > low + size:
                peaks.append(place)
            rising = False
            low = value
        elif not rising:
            low = min(low, value)
            rising = value > low + size
            high = value
            place = frame
    if rising and high > low + size:
        peaks.append(place)
    return peaks
