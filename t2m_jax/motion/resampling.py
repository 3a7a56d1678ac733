"""Motion at another frame rate or speed."""

from fractions import Fraction

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.field_checks import check_number
from t2m_jax.motion.features import bone_vectors, positions_from_bones
from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import Skeleton

MAX_FPS = 1000.0
"""Highest rate of motion; no motion capture is faster, and a larger number is probably a mistake."""
MAX_SPEED = 10.0
"""Highest factor of speed; the lowest is its inverse. A body that moves ten times faster or slower is not a body's."""
FILTER_WINDOW = ("kaiser", 10.0)
"""Window of the low-pass filter. It damps what is too fast for the new rate by 100 dB, and what stands still not."""


def check_fps(fps: float | int) -> None:
    """Raises `UserError` if a frame rate is not a number between 0 and `MAX_FPS`."""
    check_number("fps", fps)
    if not 0 < fps <= MAX_FPS:
        raise UserError(f"fps: {fps} is not a number above 0, up to {MAX_FPS:.0f} frames per second")


def check_speed(factor: float | int) -> None:
    """Raises `UserError` if a factor of speed is not a number between 1 / `MAX_SPEED` and `MAX_SPEED`."""
    check_number("speed", factor)
    if not 1 / MAX_SPEED <= factor <= MAX_SPEED:
        raise UserError(f"speed: {factor} is not a number from {1 / MAX_SPEED:g} to {MAX_SPEED:g}; 2 is twice as fast")


def resample(values: Float[np.ndarray, "T ..."], *, fps: float, new_fps: float) -> Float[np.ndarray, "U ..."]:
    """Returns a signal at another frame rate. Frame k is the value at k / `new_fps` seconds, none is after the end.

    A filter without delay removes what is too fast for the lower of the two rates, so that no vibration becomes a slow
    one, and new frames between two old ones are as lively as those that coincide with an old one.

    Raises:
        UserError: The new rate is not between 0 and `MAX_FPS`.
    """
    check_fps(new_fps)
    count = int((len(values) - 1) * new_fps / fps + 1e-6) + 1
    if new_fps == fps or count == 1:
        return values[:count]
    from scipy.signal import resample_poly  # here, because it takes long to import

    # The filter needs whole numbers. With a denominator up to the number of frames, the end drifts by less than one.
    ratio = Fraction(new_fps / fps).limit_denominator(max(10_000, len(values)))
    # Only what differs from the first value is filtered, so that what stands still stays exactly as it is.
    start = values[:1].astype(np.float64)
    moved = resample_poly(
        values - start, ratio.numerator, ratio.denominator, axis=0, window=FILTER_WINDOW, padtype="antireflect"
    )
    return (start + moved[:count]).astype(np.float32)


def resample_positions(
    positions: Float[np.ndarray, "T J 3"], *, fps: float, new_fps: float, skeleton: Skeleton
) -> Float[np.ndarray, "U J 3"]:
    """Returns a motion at another frame rate: the root's path, the directions of the bones and their lengths.

    So bones turn between frames and stay as long as they are.

    Raises:
        UserError: The new rate is not between 0 and `MAX_FPS`.
    """
    if new_fps == fps:
        return positions
    bones = bone_vectors(positions, skeleton)
    lengths = np.linalg.norm(bones, axis=-1, keepdims=True)
    root, turned, long = (
        resample(part, fps=fps, new_fps=new_fps) for part in (positions[:, 0], unit_vectors(bones), lengths)
    )
    return positions_from_bones(root, unit_vectors(turned) * long, skeleton)
