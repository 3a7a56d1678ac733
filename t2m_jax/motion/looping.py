"""The part of a motion that repeats best, closed into a loop."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.features import bone_vectors, positions_from_bones
from t2m_jax.motion.inertialization import fading_change
from t2m_jax.motion.joining import HORIZONTAL, SEAM_SECONDS, VELOCITY_SECONDS, Clip
from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.motion.travel import above_origin

LOOP_FPS = 60.0
"""Frame rate of a loop for which no other was asked, or more if the motion has more. At 20 frames a second, the feet of
a runner change their velocity by more than 1 m/s from each frame to the next, and so they do at the seam."""
SHORTEST_SECONDS = 0.6
"""Least duration of a loop; a quick runner takes two steps in this time."""
STILL_SPEED = 0.05
"""A joint that is slower stands still; meters per second."""
TOLERANCE = 0.01
"""Loops whose costs are within this of the best are as good. The longest of them is taken."""
LARGEST_DIFFERENCE = 0.25
"""Largest difference between the ends of a loop. With less alike poses, the blend would be another motion."""
ACCELERATION_SECONDS_2 = 0.01
"""A difference of 1 m/s² counts as much as a difference of this many meters."""
LONGEST_SECONDS = 60.0
MOST_STARTS = 1000
"""Longest loop, and frames that are tried as its start, evenly spaced if there are more: they bound time and memory."""


class Loop(NamedTuple):
    """The part of a motion that is played again and again."""

    start: int
    """First frame."""
    end: int
    """Last frame, in which pose and velocity are like those of the first."""
    difference: float
    """Root mean square over the joints, of their distance in meters and of the scaled difference of velocities."""


def find_loop(positions: Clip, *, fps: float) -> Loop:
    """Returns the best loop in a motion. Where it is and where it goes do not matter, but its heading does.

    Raises:
        UserError: The motion is too short, or no part of it repeats.
    """
    count = len(positions)
    shortest = max(2, round(SHORTEST_SECONDS * fps))
    if count <= shortest:
        raise UserError(f"loop: the motion has {count / fps:.1f} s; more than {SHORTEST_SECONDS} s are needed")
    from scipy.spatial.distance import cdist  # here, because it takes long to import

    poses = above_origin(positions)
    velocities = np.gradient(positions, axis=0) * fps
    accelerations = np.gradient(velocities, axis=0) * fps
    moments = np.concatenate([poses, velocities * VELOCITY_SECONDS, accelerations * ACCELERATION_SECONDS_2], axis=-1)
    # With this factor, the distance of two moments is a root mean square over the joints.
    moments = moments.reshape(count, -1) / np.sqrt(positions.shape[1])
    starts = np.arange(0, count - shortest, max(1, count // MOST_STARTS))
    # Where joints hardly accelerate, a seam shows least.
    jumps = np.sqrt(np.mean(np.sum(accelerations[starts] ** 2, axis=-1), axis=-1)) * VELOCITY_SECONDS / fps
    lengths = np.arange(shortest, min(count, round(LONGEST_SECONDS * fps)))
    costs = np.full((len(starts), len(lengths)), np.inf)
    for number, first in enumerate(starts + shortest):
        ends = moments[first : first + len(lengths)]
        costs[number, : len(ends)] = cdist(moments[[first - shortest]], ends)[0] + jumps[number]
    row, column = np.unravel_index(np.where(costs <= costs.min() + TOLERANCE, lengths, -1).argmax(), costs.shape)
    start, end = starts[row], starts[row] + lengths[column]
    difference = float(np.linalg.norm((moments[start] - moments[end]).reshape(-1, 9)[:, :6]))
    if difference > LARGEST_DIFFERENCE:
        raise UserError(f"loop: no part of the motion repeats; the most alike poses differ by {difference:.2f} m")
    return Loop(int(start), int(end), difference)


def close_loop(positions: Clip, loop: Loop, *, fps: float, skeleton: Skeleton) -> Clip:
    """Returns the frames of a loop. The last one has the pose and the velocities of the first, at another place.

    Both ends approach the pose and the velocities between theirs with cubic curves. Bones keep their lengths.
    """
    part = positions[loop.start : loop.end + 1].astype(np.float64)
    velocities = np.gradient(positions, axis=0)
    speeds = np.linalg.norm(velocities[[loop.start, loop.end]], axis=-1).mean(axis=0) * fps
    travel = _travel(part, speeds, skeleton)
    shift = (part[0] + travel - part[-1]) / 2
    faster = (velocities[loop.start] - velocities[loop.end]) / 2
    count = min(round(SEAM_SECONDS * fps), len(part) - 2)
    closed = part.copy()
    closed[0] -= shift
    closed[1 : count + 1] += fading_change(-shift, -faster, count)
    closed[-count - 1 : -1] += fading_change(shift, -faster, count)[::-1]
    closed[-1] += shift
    return _with_bones_of(part, closed, skeleton).astype(np.float32)


def _travel(part: Clip, speeds: Float[np.ndarray, " J"], skeleton: Skeleton) -> Float[np.ndarray, "3"]:
    """Returns how far a loop moves over the ground, so that a foot that does not move at the seam stays in place."""
    joints = [0, *skeleton.left_foot, *skeleton.right_foot]
    # The joint that stands decides, and not a mean with those that move. `STILL_SPEED` keeps weights finite.
    weights = 1 / (speeds[joints] ** 2 + STILL_SPEED**2)
    return np.average((part[-1] - part[0])[joints], axis=0, weights=weights) * HORIZONTAL


def _with_bones_of(part: Clip, closed: Clip, skeleton: Skeleton) -> Clip:
    """Returns `closed` with the bone lengths of `part`, which drift evenly so that both ends have the same ones."""
    lengths = np.linalg.norm(bone_vectors(part, skeleton), axis=-1, keepdims=True)
    lengths += (lengths[0] - lengths[-1]) * np.linspace(0, 1, len(part))[:, None, None]
    return positions_from_bones(closed[:, 0], unit_vectors(bone_vectors(closed, skeleton)) * lengths, skeleton)
