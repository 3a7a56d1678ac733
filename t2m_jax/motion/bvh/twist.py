"""How an upper limb is turned about its own bone, told from the bend of elbow or knee.

Positions fix where a bone points and leave its twist open. A bent hinge tells it; a straight one tells nothing, and a
nearly straight one tells mostly noise. So the twist is chosen for the whole clip at once: near the hinge where it is
bent, near the natural one where it is straight, and never faster than people turn.
"""

import numpy as np
from jaxtyping import Complex, Float

from t2m_jax.motion.rotations import (
    cross_product,
    quaternion_between,
    quaternion_inverse,
    quaternion_multiply,
    quaternion_normalize,
    rotate_vectors,
)

_NUM_ANGLES = 72
_MAX_DEGREES_PER_SECOND = 800.0
# Sine of the bend at which a hinge counts half, and how much the natural twist counts beside a fully trusted hinge.
_HALF_TRUST = 0.2
_NATURAL_WEIGHT = 0.1
# Weight of (radians per second)² against the above, which lies between -1 and 1.
_SMOOTHNESS = 1 / 400


def limb_rotations(
    upper: Float[np.ndarray, "T L 3"],
    lower: Float[np.ndarray, "T L 3"],
    *,
    rest_directions: Float[np.ndarray, "L 3"],
    hinge_axes: Float[np.ndarray, "L 3"],
    fps: float,
) -> Float[np.ndarray, "T L 4"]:
    """Returns quaternions that turn the rest direction of each upper bone to `upper` and its hinge to the bend.

    Args:
        upper: Unit directions of thighs and upper arms, in the frame of the joint above.
        lower: Unit directions of shins and forearms, same frame.
        rest_directions: Unit directions of the straight limbs at rest.
        hinge_axes: Unit axes, square to them, about which the lower bone turns when the limb bends.
        fps: Frames per second, for the speed limit.
    """
    transported = _transported_frames(upper, rest_directions)
    sideways = cross_product(rest_directions, hinge_axes)

    def as_twist(axes: Float[np.ndarray, "T L 3"]) -> Complex[np.ndarray, "T L"]:
        """Returns the part of `axes` square to the bone as a number whose argument is the twist."""
        local = rotate_vectors(quaternion_inverse(transported), axes)
        return np.sum(local * hinge_axes, axis=-1) + 1j * np.sum(local * sideways, axis=-1)

    bend = as_twist(cross_product(upper, lower))
    natural = as_twist(rotate_vectors(quaternion_between(rest_directions, upper), hinge_axes))
    # The natural twist is that of the shortest swing, which whirls about where the bone points opposite to rest.
    along = (1 + np.sum(upper * rest_directions, axis=-1)) / 2
    evidence = bend * np.abs(bend) / (np.abs(bend) ** 2 + _HALF_TRUST**2) + _NATURAL_WEIGHT * along**2 * natural
    twist = _smooth_twist(evidence, fps)
    half = twist[..., None] / 2
    turns = np.concatenate((np.cos(half), np.sin(half) * rest_directions), axis=-1)
    return quaternion_multiply(transported, turns)


def _transported_frames(
    directions: Float[np.ndarray, "T L 3"], rest_directions: Float[np.ndarray, "L 3"]
) -> Float[np.ndarray, "T L 4"]:
    """Returns rotations that carry the rest directions along with the least turn from frame to frame."""
    first = quaternion_between(rest_directions, directions[0])
    steps = quaternion_between(directions[:-1], directions[1:])
    frames = np.concatenate((first[None], steps))
    # Running products by doubling: after k rounds each entry holds the last 2^k factors.
    shift = 1
    while shift < len(frames):
        frames[shift:] = quaternion_normalize(quaternion_multiply(frames[shift:], frames[:-shift]))
        shift *= 2
    return frames


def _smooth_twist(evidence: Complex[np.ndarray, "T L"], fps: float) -> Float[np.ndarray, "T L"]:
    """Returns the unwrapped twist in radians that agrees best with `evidence` and turns slowly."""
    stiffness = _SMOOTHNESS * fps**2
    path = np.unwrap(_best_path(evidence, stiffness, fps), axis=0)
    # From the grid to a smooth curve: least squares about the path, without evidence that the path overruled.
    difference = np.angle(evidence * np.exp(-1j * path))
    weights = np.abs(evidence) * np.maximum(np.cos(difference), 0) + 1e-6
    return _smoothed(path + difference, weights, stiffness)


def _best_path(evidence: Complex[np.ndarray, "T L"], stiffness: float, fps: float) -> Float[np.ndarray, "T L"]:
    """Returns the best sequence of twists on a grid of angles, found by dynamic programming."""
    step = 2 * np.pi / _NUM_ANGLES
    reach = max(1, int(np.deg2rad(_MAX_DEGREES_PER_SECOND) / fps / step))
    moves = np.arange(-reach, reach + 1)
    move_costs = stiffness * (moves * step) ** 2
    angles = np.arange(_NUM_ANGLES) * step
    sources = (np.arange(_NUM_ANGLES)[:, None] - moves) % _NUM_ANGLES
    costs = -np.real(evidence[..., None] * np.exp(-1j * angles))
    total = costs[0]
    origins = np.zeros(costs.shape, dtype=np.int64)
    for frame in range(1, len(costs)):
        candidates = total[:, sources] + move_costs
        best = np.argmin(candidates, axis=-1)
        origins[frame] = sources[np.arange(_NUM_ANGLES), best]
        total = np.take_along_axis(candidates, best[..., None], axis=-1)[..., 0] + costs[frame]
    limbs = np.arange(costs.shape[1])
    choice = np.empty(costs.shape[:2], dtype=np.int64)
    choice[-1] = np.argmin(total, axis=-1)
    for frame in range(len(costs) - 1, 0, -1):
        choice[frame - 1] = origins[frame, limbs, choice[frame]]
    return angles[choice]


def _smoothed(
    values: Float[np.ndarray, "T L"], weights: Float[np.ndarray, "T L"], stiffness: float
) -> Float[np.ndarray, "T L"]:
    """Returns the curve x that minimises the sum of weights / 2 (x - values)² and stiffness (step of x)²."""
    ends = np.zeros(len(values))
    ends[1:] += 2 * stiffness
    ends[:-1] += 2 * stiffness
    diagonal = weights + ends[:, None]
    right = weights * values
    for frame in range(1, len(values)):  # a tridiagonal system: eliminate downwards, then substitute upwards
        factor = 2 * stiffness / diagonal[frame - 1]
        diagonal[frame] -= factor * 2 * stiffness
        right[frame] += factor * right[frame - 1]
    result = right / diagonal
    for frame in range(len(values) - 2, -1, -1):
        result[frame] += 2 * stiffness / diagonal[frame] * result[frame + 1]
    return result
