"""How feet stand on the floor: in a motion, and in the rest pose of a body."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D

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
_FLAT = np.array([1.0, 0.0, 1.0])
_INDEX = {name: i for i, name in enumerate(HUMANML3D.joint_names)}
_ANKLES, _FEET, _HIPS = ([_INDEX[f"{side}_{name}"] for side in ("left", "right")] for name in ("ankle", "foot", "hip"))

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
    hips, knees = ([_INDEX[f"{side}_{name}"] for side in ("left", "right")] for name in ("hip", "knee"))
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
    pitch = float(np.arcsin(np.clip(down[:, 1] / np.linalg.norm(down, axis=1), -1, 1)).mean())
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
        self.scale = leg_length(rest) / leg
        """Size of the body per size of the person in the motion."""
        own, wanted = stance_of_motion(self._positions, leg), stance_of_rest(rest)
        self._own = own if wanted else None
        self.pitch = self._own.pitch if self._own else None
        """Radians by which feet that stand point down in the motion, if the rest pose shows feet that stand."""
        self.lift = wanted.ankle - self.scale * own.ankle if own and wanted else 0.0
        """How much higher the body has to be than the scaled motion, so that the feet are on the floor."""
        joints = self._positions[:, [_ANKLES, _FEET]]
        low = np.quantile(joints[..., 1], LOW, axis=(0, 2), keepdims=True) + STEP * leg
        self.on_floor: Bool[np.ndarray, "T 2"] = np.any(joints[..., 1] < low, axis=1)
        """In which frames the left and the right foot are on the floor, or nearly so."""
        steps = np.diff(joints[..., [0, 2]], axis=0, append=joints[-1:, ..., [0, 2]])
        slow = np.linalg.norm(steps, axis=-1).min(axis=1) * motion.fps < SLOW * leg
        # Feet of one step point into one direction, whatever the noise of their joints says.
        axes = turns[:, _ANKLES][..., 0] * _FLAT
        self._sideways = np.stack([_held(axes[:, k], (self.on_floor & slow)[:, k]) for k in range(2)], axis=1)

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
        length = np.linalg.norm((self._rest[_FEET] - self._rest[_ANKLES]) * _FLAT, axis=-1).mean()
        own = np.linalg.norm(self._positions[:, _FEET] - self._positions[:, _ANKLES], axis=-1).mean()
        balls += (length - self.scale * own * np.cos(self._own.pitch)) * np.cross(self._sideways, [0.0, 1.0, 0.0])
        height = self._rest[_FEET, 1].mean() - self._rest[_ANKLES, 1].mean()
        balls[..., 1] += self.lift + height + self.scale * (self._own.ankle - self._own.ball)
        raised = np.maximum(self._positions[:, _ANKLES, 1] - self._own.ankle, 0) + EVEN * self._leg
        lifted = np.maximum(self._positions[:, _FEET, 1] - self._own.ball, 0)
        share = (raised**2 / (raised**2 + lifted**2))[..., None]
        return share * (balls - soles) + (1 - share) * ankles


def _held(vectors: Float[np.ndarray, "T 3"], standing: Bool[np.ndarray, " T"]) -> Float[np.ndarray, "T 3"]:
    """Returns vectors that are constant in each run of frames in which a foot stands, and change between them."""
    frames = np.flatnonzero(standing)
    if not len(frames):
        return vectors
    runs = np.cumsum(np.diff(frames, prepend=frames[0]) > GAP)
    counts = np.bincount(runs)
    columns = (np.bincount(runs, column[frames]) / counts for column in vectors.T)
    return np.stack([np.interp(np.arange(len(vectors)), frames, column[runs]) for column in columns], axis=-1)


def _distance(joints: Rest, pair: list[int]) -> float:
    return float(np.linalg.norm(joints[pair[0]] - joints[pair[1]]))
