"""Changes of whole motions: another frame rate, and one motion after another."""

from fractions import Fraction

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.features import bone_vectors, facing, positions_from_bones
from t2m_jax.motion.rotations import quaternion_between, rotate_vectors, unit_vectors
from t2m_jax.motion.skeleton import Skeleton

MAX_FPS = 1000.0
"""Highest rate of motion; no motion capture is faster, and a larger number is probably a mistake."""
MAX_SPEED = 10.0
"""Highest factor of speed; the lowest is its inverse. A body that moves ten times faster or slower is not a body's."""
BLEND_SECONDS = 0.4
"""Time in which the pose at the end of a motion fades into the one that follows."""
FILTER_WINDOW = ("kaiser", 10.0)
"""Window of the low-pass filter. It damps what is too fast for the new rate by 100 dB, and what stands still not."""
HORIZONTAL = np.array([1.0, 0.0, 1.0], np.float32)
"""Leaves out heights."""


def check_fps(fps: float) -> None:
    """Raises `UserError` if a frame rate is not between 0 and `MAX_FPS`."""
    if not 0 < fps <= MAX_FPS:
        raise UserError(f"fps: {fps} is not a number above 0, up to {MAX_FPS:.0f} frames per second")


def check_speed(factor: float | int) -> None:
    """Raises `UserError` if a factor of speed is not between 1 / `MAX_SPEED` and `MAX_SPEED`."""
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

    ratio = Fraction(new_fps / fps).limit_denominator(max(10_000, len(values)))
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


def place_positions(
    positions: Float[np.ndarray, "T J 3"],
    pose: Float[np.ndarray, "J 3"],
    target: Float[np.ndarray, "J 3"],
    *,
    skeleton: Skeleton,
) -> Float[np.ndarray, "T J 3"]:
    """Returns a motion turned and moved on the ground, so that `pose` gets the place and the heading of `target`."""
    turn = quaternion_between(facing(pose, skeleton), facing(target, skeleton))
    return rotate_vectors(turn[None, None], positions - pose[0] * HORIZONTAL) + target[0] * HORIZONTAL


def fading_change(differences: Float[np.ndarray, "_ J 3"], count: int) -> Float[np.ndarray, "U J 3"]:
    """Returns what to add to the `count` frames after a join, so that they go on smoothly from the frames before it.

    Args:
        differences: What the last one or two frames before the join differ by from those that lead to the frames after
            it; the last frame comes first.
        count: Frames in which a cubic curve goes from this difference and its velocity to zero.
    """
    change = differences[0]
    speed = change - differences[1] if len(differences) > 1 else 0 * change
    time = (np.arange(1, count + 1) / (count + 1))[:, None, None]
    return (1 - time) ** 2 * (change * (1 + 2 * time) + (count + 1) * speed * time)


def replace_middle(
    head: Float[np.ndarray, "_ J 3"],
    generated: Float[np.ndarray, "T J 3"],
    tail: Float[np.ndarray, "_ J 3"],
    *,
    first: int,
    last: int,
    fps: float,
    skeleton: Skeleton,
) -> Float[np.ndarray, "U J 3"]:
    """Returns `head`, frames `first` to `last` of a generated motion, and `tail`, moved to where these have come.

    The generated motion has frames for head and tail, too. What they differ by at the joins, in pose and in velocity,
    is added to the middle and fades in it. Head and tail stay as they are. Bones have the lengths of the head's,
    or of the tail's if there is no head.

    Args:
        head: Frames before the join; may have none.
        generated: A motion whose frames before `first` are like the head's, and those from `last` like the tail's.
        tail: Frames after the middle; may have none.
        first: First frame of the middle.
        last: Frame after the middle.
        fps: Of all three.
        skeleton: Of all three.
    """
    kept = next(part for part in (head, tail, generated) if len(part))
    if len(head):
        generated = place_positions(generated, generated[first - 1], head[-1], skeleton=skeleton)
    if len(tail):
        tail = place_positions(tail, tail[0], generated[last], skeleton=skeleton)
    middle, count = generated[first:last].astype(np.float64), min(round(BLEND_SECONDS * fps), last - first)
    if len(head):
        differences = (head[-2:] - generated[max(0, first - 2) : first])[::-1]
        middle[:count] += fading_change(differences, count)
    if len(tail):
        middle[-count:] += fading_change(tail[:2] - generated[last : last + 2], count)[::-1]
    lengths = np.linalg.norm(bone_vectors(kept, skeleton), axis=-1, keepdims=True)[:1]
    middle = positions_from_bones(middle[:, 0], unit_vectors(bone_vectors(middle, skeleton)) * lengths, skeleton)
    return np.concatenate([head, middle, tail]).astype(np.float32)


def join_positions(
    first: Float[np.ndarray, "T J 3"], second: Float[np.ndarray, "U J 3"], *, fps: float, skeleton: Skeleton
) -> Float[np.ndarray, "V J 3"]:
    """Returns one motion after another, T + U - 1 frames.

    The second one is turned and moved, so that its first frame has the place and the heading of the last frame of the
    first one, which it replaces. What remains of the difference of these two poses fades out.
    """
    moved = place_positions(second, second[0], first[-1], skeleton=skeleton)
    time = np.minimum(np.arange(len(second)) / (BLEND_SECONDS * fps), 1.0)[:, None, None]
    fading = (1 - time) ** 2 * (1 + 2 * time)
    blended = moved + fading * (first[-1] - moved[0])
    return np.concatenate([first, blended[1:]]).astype(np.float32)
