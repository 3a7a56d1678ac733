"""Motion for games: without travel, and closed into a loop."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.editing import HORIZONTAL
from t2m_jax.motion.features import bone_vectors, positions_from_bones
from t2m_jax.motion.joining import VELOCITY_SECONDS
from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import Skeleton

SHORTEST_SECONDS = 0.6
"""Least duration of a loop; a quick runner takes two steps in this time."""
BLEND_SECONDS = 0.5
"""Time before the end in which a loop approaches its first pose."""
TOLERANCE = 0.01
"""Loops whose costs are within this of the best are as good. The longest of them is taken."""
LARGEST_DIFFERENCE = 0.25
"""Largest difference between the ends of a loop. With less alike poses, the blend would be another motion."""
MOST_STARTS = 1000
"""Frames that are tried as the start of a loop, evenly spaced if there are more, so that memory is bounded."""


class Loop(NamedTuple):
    """The part of a motion that is played again and again."""

    start: int
    """First frame."""
    end: int
    """Last frame, in which pose and velocity are like those of the first."""
    difference: float
    """Root mean square over the joints, of their distance in meters and of the scaled difference of velocities."""


def keep_in_place(positions: Float[np.ndarray, "T J 3"]) -> Float[np.ndarray, "T J 3"]:
    """Returns a motion whose root stays above the origin. Heights and heading, and so contacts, keep their timing."""
    return positions - positions[:, :1] * HORIZONTAL


def find_loop(positions: Float[np.ndarray, "T J 3"], *, fps: float) -> Loop:
    """Returns the best loop in a motion. Where it is and where it goes do not matter, but its heading does.

    Raises:
        UserError: The motion is too short, or no part of it repeats.
    """
    count, shortest = len(positions), max(2, round(SHORTEST_SECONDS * fps))
    if count <= shortest:
        raise UserError(f"loop: the motion has {count / fps:.1f} s; more than {SHORTEST_SECONDS} s are needed")
    from scipy.spatial.distance import cdist  # here, because it takes long to import

    velocities = np.gradient(positions, axis=0) * fps
    frames = np.concatenate([keep_in_place(positions), velocities * VELOCITY_SECONDS], axis=-1).reshape(count, -1)
    starts = np.arange(0, count - shortest, max(1, count // MOST_STARTS))
    # Where joints hardly accelerate, a seam shows least.
    jumps = np.linalg.norm(np.gradient(velocities, axis=0).reshape(count, -1), axis=-1) * VELOCITY_SECONDS
    differences = cdist(frames[starts], frames) / np.sqrt(positions.shape[1])
    costs = differences + jumps[starts, None] / np.sqrt(positions.shape[1])
    lengths = np.arange(count) - starts[:, None]
    costs[lengths < shortest] = np.inf
    row, end = np.unravel_index(np.where(costs <= costs.min() + TOLERANCE, lengths, -1).argmax(), costs.shape)
    difference = float(differences[row, end])
    if difference > LARGEST_DIFFERENCE:
        raise UserError(f"loop: no part of the motion repeats; the most alike poses differ by {difference:.2f} m")
    return Loop(int(starts[row]), int(end), difference)


def close_loop(
    positions: Float[np.ndarray, "T J 3"], loop: Loop, *, fps: float, skeleton: Skeleton
) -> Float[np.ndarray, "U J 3"]:
    """Returns the frames of a loop. The last one has the pose and the velocities of the first, at another place.

    In the time before it, a cubic correction of position and velocity grows. Bones keep their lengths.
    """
    part = positions[loop.start : loop.end + 1].astype(np.float64)
    velocities = np.gradient(positions, axis=0)
    count = min(round(BLEND_SECONDS * fps), len(part) - 1)
    shift = keep_in_place(part[:1])[0] - keep_in_place(part[-1:])[0]
    faster = (velocities[loop.start] - velocities[loop.end]) * count
    time = (np.arange(1, count + 1) / count)[:, None, None]
    closed = part.copy()
    closed[-count:] += shift * time**2 * (3 - 2 * time) + faster * time**2 * (time - 1)
    lengths = np.linalg.norm(bone_vectors(part, skeleton), axis=-1, keepdims=True)
    # At the end, the bones are those of the first frame, so that the pose is the same.
    lengths[-count:] += (lengths[0] - lengths[-1]) * time
    bones = unit_vectors(bone_vectors(closed, skeleton)) * lengths
    return positions_from_bones(closed[:, 0], bones, skeleton).astype(np.float32)
