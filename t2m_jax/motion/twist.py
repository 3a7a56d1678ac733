"""The twist of upper limbs about their own bone, estimated from the bend of elbow or knee.

Joint positions determine the direction of a bone, but not its twist. A bent hinge shows the twist. A straight one does
not, and a nearly straight one shows mostly noise. So the twist is chosen for the whole clip at once: it is close to the
hinge's while that is bent, close to the natural twist while it is straight, and never faster than people move.
"""

import numpy as np
from jaxtyping import Complex, Float

from t2m_jax.motion import rotations

Directions = Float[np.ndarray, "T L 3"]
Angles = Float[np.ndarray, "T L"]
Twists = Complex[np.ndarray, "T L"]
"""Numbers whose arguments are angles of twist, and whose lengths say how much they count."""

NUM_ANGLES = 72
MAX_DEGREES_PER_SECOND = 800.0
# Sine of the bend at which a hinge has half of its full weight, and the weight of the natural twist relative to that.
HALF_TRUST = 0.2
NATURAL_WEIGHT = 0.1
# Weight of (radians per second)² relative to the two above, whose costs are between -1 and 1.
SMOOTHNESS = 1 / 400


def limb_rotations(
    upper: Directions,
    lower: Directions,
    *,
    rest_directions: Float[np.ndarray, "L 3"],
    hinge_axes: Float[np.ndarray, "L 3"],
    fps: float,
) -> Float[np.ndarray, "T L 4"]:
    """Returns quaternions that rotate the rest direction of each upper bone to `upper`, and its hinge to the bend.

    Args:
        upper: Unit directions of thighs and upper arms in the parent joint's frame.
        lower: Unit directions of shins and forearms in the same frame.
        rest_directions: Unit directions of the straight limbs in the rest pose.
        hinge_axes: Unit axes, perpendicular to them, about which the lower bone rotates when the limb bends.
        fps: Frames per second, for the speed limit.
    """
    # Rotations of the rest directions to `upper` that turn as little as possible from frame to frame. They are running
    # products, computed by doubling: after k rounds, each entry is the product of the last 2^k factors.
    first = rotations.quaternion_between(rest_directions, upper[0])
    transported = np.concatenate((first[None], rotations.quaternion_between(upper[:-1], upper[1:])))
    shift = 1
    while shift < len(transported):
        product = rotations.quaternion_multiply(transported[shift:], transported[:-shift])
        transported[shift:] = rotations.unit_vectors(product)
        shift *= 2
    sideways = rotations.cross_product(rest_directions, hinge_axes)

    def as_twist(axes: Directions) -> Twists:
        """Returns the part of `axes` perpendicular to the bone as complex numbers with the twist as argument."""
        local = rotations.rotate_vectors(rotations.quaternion_inverse(transported), axes)
        return np.sum(local * hinge_axes, axis=-1) + 1j * np.sum(local * sideways, axis=-1)

    bend = as_twist(rotations.cross_product(upper, lower))
    natural = as_twist(rotations.rotate_vectors(rotations.quaternion_between(rest_directions, upper), hinge_axes))
    # The natural twist is that of the shortest swing. It is unstable, so it gets less weight, if the bone points away
    # from its rest direction.
    along = (1 + np.sum(upper * rest_directions, axis=-1)) / 2
    evidence = bend * np.abs(bend) / (np.abs(bend) ** 2 + HALF_TRUST**2) + NATURAL_WEIGHT * along**2 * natural
    stiffness = SMOOTHNESS * fps**2
    path = np.unwrap(_best_path(evidence, stiffness, fps), axis=0)
    # A least-squares fit turns the path on the grid into a smooth curve. Evidence that contradicts the path is ignored.
    difference = np.angle(evidence * np.exp(-1j * path))
    weights = np.abs(evidence) * np.maximum(np.cos(difference), 0) + 1e-6
    twist = _smoothed(path + difference, weights, stiffness)
    half = twist[..., None] / 2
    turns = np.concatenate((np.cos(half), np.sin(half) * rest_directions), axis=-1)
    return rotations.quaternion_multiply(transported, turns)


def _best_path(evidence: Twists, stiffness: float, fps: float) -> Angles:
    """Returns the best sequence of twists on a grid of angles (dynamic programming)."""
    step = 2 * np.pi / NUM_ANGLES
    reach = max(1, int(np.deg2rad(MAX_DEGREES_PER_SECOND) / fps / step))
    reach = min(reach, NUM_ANGLES // 2)  # any angle
    moves = np.arange(-reach, reach + 1)
    move_costs = stiffness * (moves * step) ** 2
    angles = np.arange(NUM_ANGLES) * step
    sources = (np.arange(NUM_ANGLES)[:, None] - moves) % NUM_ANGLES
    grid = np.exp(-1j * angles)
    total = -np.real(evidence[0][:, None] * grid)
    # The only array of frames and angles, so that a long motion needs little memory.
    origins = np.zeros((*evidence.shape, NUM_ANGLES), np.min_scalar_type(NUM_ANGLES))
    for frame in range(1, len(evidence)):
        candidates = total[:, sources] + move_costs
        best = np.argmin(candidates, axis=-1)
        origins[frame] = sources[np.arange(NUM_ANGLES), best]
        costs = -np.real(evidence[frame][:, None] * grid)
        total = np.take_along_axis(candidates, best[..., None], axis=-1)[..., 0] + costs
    limbs = np.arange(evidence.shape[1])
    choice = np.empty(evidence.shape, dtype=np.int64)
    choice[-1] = np.argmin(total, axis=-1)
    for frame in range(len(evidence) - 1, 0, -1):
        choice[frame - 1] = origins[frame, limbs, choice[frame]]
    return angles[choice]


def _smoothed(values: Angles, weights: Angles, stiffness: float) -> Angles:
    """Returns the curve x that minimizes the sum of weights / 2 (x - values)² and stiffness (step of x)²."""
    from scipy.linalg import solve_banded  # here, because it takes long to import

    ends = np.zeros(len(values))
    ends[1:] += 2 * stiffness
    ends[:-1] += 2 * stiffness
    neighbors = np.full(len(values), -2 * stiffness)
    # A tridiagonal system for each limb, by its three diagonals.
    systems = [(neighbors, diagonal, neighbors) for diagonal in (weights + ends[:, None]).T]
    sides = (weights * values).T
    return np.stack([solve_banded((1, 1), one, side) for one, side in zip(systems, sides, strict=True)], axis=1)
