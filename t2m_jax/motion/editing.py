"""Changes of whole motions: another frame rate, and one motion after another."""

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.features import facing, smooth_over_time
from t2m_jax.motion.rotations import quaternion_between, rotate_vectors
from t2m_jax.motion.skeleton import Skeleton

MAX_FPS = 1000.0
"""Highest rate of motion; no motion capture is faster, and a larger number is probably a mistake."""
BLEND_SECONDS = 0.4
"""Time in which the pose at the end of a motion fades into the one that follows."""
ANTI_ALIASING = 0.4
"""Standard deviation of the smoothing before frames are left out, in frames that are kept."""


def resample_positions(
    positions: Float[np.ndarray, "T J 3"], *, fps: float, new_fps: float
) -> Float[np.ndarray, "U J 3"]:
    """Returns the same motion at another frame rate. Frame k is the pose at k / `new_fps` seconds.

    Joints move on cubic splines. Before frames are left out, the motion is smoothed, so that no fast vibration becomes
    a slow one. No frame is after the motion's end.

    Raises:
        UserError: The new rate is not between 0 and `MAX_FPS`.
    """
    if not 0 < new_fps <= MAX_FPS:
        raise UserError(f"fps: {new_fps} is not a number above 0, up to {MAX_FPS:.0f}")
    if new_fps == fps or len(positions) == 1:
        return positions
    from scipy.interpolate import CubicSpline  # here, because it takes long to import

    flat = positions.reshape(len(positions), -1)
    if new_fps < fps:
        flat = smooth_over_time(flat, sigma=ANTI_ALIASING * fps / new_fps)
    count = int((len(flat) - 1) * new_fps / fps + 1e-6) + 1
    times = np.minimum(np.arange(count) * fps / new_fps, len(flat) - 1)
    resampled = CubicSpline(np.arange(len(flat)), flat)(times)
    return resampled.reshape(count, *positions.shape[1:]).astype(np.float32)


def join_positions(
    first: Float[np.ndarray, "T J 3"], second: Float[np.ndarray, "U J 3"], *, fps: float, skeleton: Skeleton
) -> Float[np.ndarray, "V J 3"]:
    """Returns one motion after another, T + U - 1 frames.

    The second one is turned and moved, so that its first frame has the place and the heading of the last frame of the
    first one, which it replaces. What remains of the difference of these two poses fades out.
    """
    turn = quaternion_between(facing(second[0], skeleton), facing(first[-1], skeleton))
    horizontal = np.array([1.0, 0.0, 1.0], np.float32)
    moved = rotate_vectors(turn[None, None], second - second[0, 0] * horizontal) + first[-1, 0] * horizontal
    time = np.minimum(np.arange(len(second)) / (BLEND_SECONDS * fps), 1.0)[:, None, None]
    fading = (1 - time) ** 2 * (1 + 2 * time)
    blended = moved + fading * (first[-1] - moved[0])
    return np.concatenate([first, blended[1:]]).astype(np.float32)
