"""How feet stand on the floor: in a motion, and in the rest pose of a body."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import JOINT

LOW = 0.05
"""A foot stands if it is about as low as in this share of the frames."""
HIGHEST_ANKLE = 0.2
"""An ankle that is never lower than this, in lengths of a leg, never stands."""
NEAR_FLOOR = (-0.05, 0.25)
"""Height of the lowest joint, in lengths of a leg, of a body that stands on the ground of its file."""
FLAT = (5.0, 70.0)
"""Degrees by which a foot that stands points down from ankle to ball."""
EVEN = 0.01
"""The ball decides where a foot is if it is lower than this above where it stands; lengths of a leg."""
STEP = 0.06
"""A foot is on the floor if its ankle is at most this much higher than when it stands; lengths of a leg."""
SLOW = 0.5
"""A foot stands if its ankle or its ball moves less than this over the floor; lengths of a leg in a second."""
GAP = 2
"""Frames in which a foot that stands may seem not to."""
EASE_SECONDS = 0.15
"""Time before and after a step on the ball of a foot in which the ball begins and stops to decide."""
LONGER = 0.2
"""A foot that is longer than that of the motion, by this share of its length or more, points where `ahead` says."""

_FLAT = np.array([1.0, 0.0, 1.0])
_UP = np.array([0.0, 1.0, 0.0])
_ANKLES, _FEET, _HIPS = ([JOINT[f"{side}_{name}"] for side in ("left", "right")] for name in ("ankle", "foot", "hip"))

Joints = Float[np.ndarray, "T 22 3"]
Rest = Float[np.ndarray, "22 3"]


class Stance(NamedTuple):
    """Feet that stand."""

    ankle: float
    """Height of the ankles above the floor."""
    ball: float
    """The same of the balls of the feet."""
    pitch: float
    """Radians by which the line from the ankle to the ball points down."""


def leg_length(joints: Float[np.ndarray, "22 3"]) -> float:
    """Returns the mean length of thigh and shin."""
    hips, knees = ([JOINT[f"{side}_{name}"] for side in ("left", "right")] for name in ("hip", "knee"))
    thighs, shins = joints[knees] - joints[hips], joints[_ANKLES] - joints[knees]
    return float((np.linalg.norm(thighs, axis=1) + np.linalg.norm(shins, axis=1)).mean())


def stance_of_motion(positions: Float[np.ndarray, "T 22 3"], leg: float) -> Stance | None:
    """Returns how the feet stand in a motion with the floor at y = 0, None if they never do."""
    ankle, ball = (float(np.quantile(positions[:, joints, 1], LOW, axis=0).min()) for joints in (_ANKLES, _FEET))
    length = float(np.linalg.norm(positions[:, _FEET] - positions[:, _ANKLES], axis=-1).mean())
    if ankle > HIGHEST_ANKLE * leg or length == 0:
        return None
    return Stance(ankle, ball, float(np.arcsin(np.clip((ankle - ball) / length, 0.0, np.sin(np.deg2rad(FLAT[1]))))))


def stance_of_rest(rest: Float[np.ndarray, "22 3"]) -> Stance | None:
    """Returns how the feet stand in a rest pose, None if it does not show it: feet of a T-pose may point ahead."""
    down = rest[_ANKLES] - rest[_FEET]
    lengths = np.maximum(np.linalg.norm(down, axis=1), 1e-9)  # a foot may have no length
    pitch = float(np.arcsin(np.clip(down[:, 1] / lengths, -1, 1)).mean())
    if not FLAT[0] < np.rad2deg(pitch) < FLAT[1]:
        return None
    leg = leg_length(rest)
    lowest = float(rest[:, 1].min())
    floor = 0.0 if NEAR_FLOOR[0] * leg <= lowest <= NEAR_FLOOR[1] * leg else lowest
    ankle, ball = (float(rest[joints, 1].mean()) - floor for joints in (_ANKLES, _FEET))
    return Stance(ankle, ball, pitch)


class Steps:
    """Where the feet of a body are in a motion."""

    def __init__(self, motion: Motion, turns: Float[np.ndarray, "T 22 3 3"], rest: Rest, *, leg: float) -> None:
        """Compares how feet stand in the motion and in the rest pose.

        Args:
            motion: A motion.
            turns: World rotations of its joints from the T-pose.
            rest: The joints of the body in its rest pose.
            leg: Length of a leg of the person in the motion.
        """
        self._positions = np.asarray(motion.positions, np.float64)
        self._rest = rest
        self._leg = leg
        self._length = np.linalg.norm(self._positions[:, _FEET] - self._positions[:, _ANKLES], axis=-1).mean()
        self.scale = leg_length(rest) / leg
        """Size of the body per size of the person in the motion."""
        self._own = own = stance_of_motion(self._positions, leg)
        wanted = stance_of_rest(rest) if own else None
        self.pitch = own.pitch if own and wanted else None
        """Radians by which feet that stand point down in the motion, if the rest pose shows feet that stand."""
        soles = rest[_FEET] - rest[_ANKLES]
        self._ahead, self._down = np.linalg.norm(soles * _FLAT, axis=-1).mean(), -soles[:, 1].mean()
        if own and not wanted:  # then its feet are compared by direction, so they stand as those of the motion
            length = np.linalg.norm(soles, axis=-1).mean()
            self._ahead, self._down = length * np.cos(own.pitch), length * np.sin(own.pitch)
        self.lift = 0.0
        """How much higher the body has to be than the scaled motion, so that the feet are on the floor."""
        if own:
            self.lift = float((wanted.ankle if wanted else self._down + self.scale * own.ball) - self.scale * own.ankle)
        joints = self._positions[:, [_ANKLES, _FEET]]
        low = joints[..., 1] < np.quantile(joints[..., 1], LOW, axis=(0, 2), keepdims=True) + STEP * leg
        self.on_floor: Bool[np.ndarray, "T 2"] = np.any(low, axis=1)
        """In which frames the left and the right foot are on the floor, or nearly so."""
        steps = np.linalg.norm(np.diff(joints[..., [0, 2]], axis=0), axis=-1) * motion.fps < SLOW * leg
        # The first frame of a step is slow only to the next one, the last frame only from the one before.
        slow = np.pad(steps, ((0, 1), (0, 0), (0, 0))) | np.pad(steps, ((1, 0), (0, 0), (0, 0)))
        standing = low & slow
        self._on_ball = _eased(standing[:, 1], round(EASE_SECONDS * motion.fps))
        # Feet of one step point into one direction, whatever the noise of their joints says.
        axes = turns[:, _ANKLES][..., 0] * _FLAT
        self._sideways = np.stack([_held(axes[:, k], standing[:, :, k].any(axis=1)) for k in range(2)], axis=1)

    def level(self, sole: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Returns the vector from ankle to ball in the rest pose, or its level part if the foot stands in this pose."""
        return sole if self.pitch is None else sole * _FLAT

    def rolled(
        self, soles: Float[np.ndarray, "T 2 3"], ahead: Float[np.ndarray, "T 2 3"]
    ) -> Float[np.ndarray, "T 2 3"]:
        """Returns soles of which heels rise as high as in the motion while the ball of the foot is on the floor.

        The ankles of longer feet, turned as those of the motion, would be higher and slide.

        Args:
            soles: Vectors from the ankles to the balls of the body, turned as in the motion.
            ahead: Vectors that are level when the feet stand flat, turned with them. They say where a foot points: the
                sole of a high ankle is nearly upright when its heel rises.
        """
        if self._own is None:
            return soles
        length = np.maximum(np.linalg.norm(soles, axis=-1), 1e-9)  # a foot may have no length
        share = np.minimum(self.scale * self._length / length, 1)
        heights = soles[..., 1] + self._on_ball * (1 - share) * (-self._down - soles[..., 1])
        headings = _headings(soles, ahead, self._on_ball * np.minimum((1 - share) / LONGER, 1))
        return np.sqrt(np.maximum(length**2 - heights**2, 0))[..., None] * headings + heights[..., None] * _UP

    def ankles(self, soles: Float[np.ndarray, "T 2 3"]) -> Float[np.ndarray, "T 2 3"]:
        """Returns where the ankles of the body should be.

        Feet of another length cannot have both the heel and the ball where the motion has them. What is on the floor
        decides, so that neither slides.

        Args:
            soles: Vectors from the ankles to the balls of the body.
        """
        # Legs of a body with wider hips are farther apart.
        wider = _distance(self._rest, _HIPS) - self.scale * _distance(self._positions[0], _HIPS)
        apart = wider / 2 * self._sideways * np.array([[1.0], [-1.0]])
        ankles, balls = (self.scale * self._positions[:, joints] + apart for joints in (_ANKLES, _FEET))
        ankles[..., 1] += self.lift
        if self._own is None:
            return ankles
        longer = self._ahead - self.scale * self._length * np.cos(self._own.pitch)
        balls += longer * np.cross(self._sideways, _UP)
        balls[..., 1] += self.lift - self._down + self.scale * (self._own.ankle - self._own.ball)
        raised = np.maximum(self._positions[:, _ANKLES, 1] - self._own.ankle, 0) + EVEN * self._leg
        lifted = np.maximum(self._positions[:, _FEET, 1] - self._own.ball, 0)
        share = np.maximum(raised**2 / (raised**2 + lifted**2), self._on_ball)[..., None]
        return share * (balls - soles) + (1 - share) * ankles


def _headings(
    soles: Float[np.ndarray, "T 2 3"], ahead: Float[np.ndarray, "T 2 3"], share: Float[np.ndarray, "T 2"]
) -> Float[np.ndarray, "T 2 3"]:
    """Returns where soles point on the floor, and to a share where `ahead` points."""
    own, other = (unit_vectors(vectors * _FLAT) for vectors in (soles, ahead))
    return unit_vectors((1 - share[..., None]) * own + share[..., None] * other)


def _held(vectors: Float[np.ndarray, "T 3"], standing: Bool[np.ndarray, " T"]) -> Float[np.ndarray, "T 3"]:
    """Returns vectors that are constant in each run of frames in which a foot stands, and change between them."""
    frames = np.flatnonzero(standing)
    if not len(frames):
        return vectors
    runs = np.cumsum(np.diff(frames, prepend=frames[0]) > GAP)
    counts = np.bincount(runs)
    columns = (np.bincount(runs, column[frames]) / counts for column in vectors.T)
    return np.stack([np.interp(np.arange(len(vectors)), frames, column[runs]) for column in columns], axis=-1)


def _eased(standing: Bool[np.ndarray, "T 2"], reach: int) -> Float[np.ndarray, "T 2"]:
    """Returns 1 in frames in which a foot stands, and less and less in those around them, down to 0 beyond `reach`."""
    shares = (1 + np.cos(np.pi * np.arange(-reach, reach + 1) / (reach + 1))) / 2
    around = np.lib.stride_tricks.sliding_window_view(np.pad(standing, ((reach, reach), (0, 0))), 2 * reach + 1, axis=0)
    return np.max(around * shares, axis=-1)


def _distance(joints: Rest, pair: list[int]) -> float:
    return float(np.linalg.norm(joints[pair[0]] - joints[pair[1]]))
