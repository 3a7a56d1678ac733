"""The travel of a motion over the floor, without the sway of its steps: what a root bone carries."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.features import facing, gaussian_kernel
from t2m_jax.motion.joining import HORIZONTAL, Clip
from t2m_jax.motion.rotations import quaternion_inverse, quaternion_multiply, rotate_vectors
from t2m_jax.motion.skeleton import Skeleton

SWAY_SECONDS = 0.4
"""Standard deviation of the Gaussian that smooths the path of the root, so that the sway of a step is not a turn."""
CLOSED = 0.005
"""A motion is a loop if no joint of its last pose is farther from that of its first; meters, without the travel."""


class Travel(NamedTuple):
    """A frame of reference that moves over the floor with a figure, and turns as it does."""

    places: Float[np.ndarray, "T 3"]
    turns: Float[np.ndarray, "T 4"]
    """Rotations about Y as quaternions; the identity faces +Z."""

    def local_places(self, places: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
        """Returns places of the world as this frame sees them."""
        return rotate_vectors(quaternion_inverse(self.turns), places - self.places)

    def local_turns(self, turns: Float[np.ndarray, "T 4"]) -> Float[np.ndarray, "T 4"]:
        """Returns rotations of the world as this frame sees them."""
        return quaternion_multiply(quaternion_inverse(self.turns), turns)


def find_travel(positions: Clip, *, fps: float, skeleton: Skeleton) -> Travel:
    """Returns where a figure is on the floor and where it faces, without the sway of its steps."""
    directions = _smooth(facing(positions, skeleton), positions, fps)
    half = np.arctan2(directions[:, 0], directions[:, 2]) / 2
    turns = np.stack([np.cos(half), 0 * half, np.sin(half), 0 * half], axis=1)
    return Travel(smooth_path(positions, fps=fps), turns)


def smooth_path(positions: Clip, *, fps: float) -> Float[np.ndarray, "T 3"]:
    """Returns the path of the root over the floor without its sway."""
    return _smooth(positions[:, 0] * HORIZONTAL, positions, fps)


def keep_in_place(positions: Clip, *, fps: float) -> Clip:
    """Returns a motion without travel, around the origin. The sway of the hips, heights and heading are as before.

    A loop stays one.
    """
    return (positions - smooth_path(positions, fps=fps)[:, None]).astype(np.float32)


def above_origin(positions: Clip) -> Clip:
    """Returns each pose with its root above the origin."""
    return positions - positions[:, :1] * HORIZONTAL


def _smooth(values: Float[np.ndarray, "T 3"], positions: Clip, fps: float) -> Float[np.ndarray, "T 3"]:
    """Returns values of each frame smoothed over time; those of a loop continue at its seam."""
    values = values.astype(np.float64)
    if len(values) == 1:
        return values
    first, last = above_origin(positions[[0, -1]])
    is_loop = np.linalg.norm(last - first, axis=-1).max() < CLOSED
    kernel = gaussian_kernel(SWAY_SECONDS * fps)
    reach = len(kernel) // 2
    # Beyond its ends, a path continues as it was, mirrored at the end point; that of a loop goes round once more.
    steps = np.pad(np.diff(values, axis=0), ((reach, reach), (0, 0)), mode="wrap" if is_loop else "symmetric")
    start = values[:1] - steps[:reach].sum(axis=0)
    longer = start + np.cumsum(np.concatenate([np.zeros((1, 3)), steps]), axis=0)
    return np.stack([np.convolve(axis, kernel, mode="valid") for axis in longer.T], axis=1)
