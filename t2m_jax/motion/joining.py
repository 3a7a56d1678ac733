"""All ways in which one motion follows another. What differs at a join fades, always as `fade` says."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.features import facing, gaussian_kernel, local_positions, smooth_over_time
from t2m_jax.motion.inertialization import Clip, Moment, Pose, fade, feet_above, follow_on, with_bones_of
from t2m_jax.motion.rotations import quaternion_between, rotate_vectors
from t2m_jax.motion.skeleton import Skeleton

FADE_SECONDS = 0.4
"""Time in which a pose, or the features of a sentence, fade into those that follow. Sentences are sampled and decoded
as if they were alone: after rows of another action, a generator obeys less often, and a decoder mixes the two."""
SEAM_SECONDS = 0.5
"""Time on each side of a seam in which motion is changed if both sides may be: at the ends of a loop, and where
sentences meet."""
SEAM_SIGMA = 0.1
"""Standard deviation of the filter where sentences meet, in seconds. docs/howto/animator.md says how much joints
accelerate there with it."""
OVERLAP = 12
"""Frames in which one clip of features fades into another one that was recorded, at a cut between poses that match."""
VELOCITY_SECONDS = 0.2
"""A difference of 1 m/s counts as much as a difference of this many meters."""

Features = Float[np.ndarray, "_ D"]
"""Raw features of a motion."""

HORIZONTAL = np.array([1.0, 0.0, 1.0], np.float32)
"""Leaves out heights."""


class Cut(NamedTuple):
    """Where two clips are joined."""

    end: int
    """Frames of the first clip, with the overlap."""
    start: int
    """First frame of the second clip, where the overlap begins."""
    cost: float
    """Mean distance of the joints in the middle of the overlap, in the skeleton's unit, and of their velocities."""


def find_cut(first: Features, second: Features, *, ends: range, starts: range, skeleton: Skeleton) -> Cut:
    """Returns the cut at which two clips of raw features are most alike.

    Args:
        first: Clip that is joined to its beginning.
        second: Clip that follows.
        ends: Frames of the first clip that may be kept; at least `OVERLAP`.
        starts: First frames of the second clip that may be used; `OVERLAP` frames must follow.
        skeleton: Of both clips.
    """
    # Poses are compared where both clips count the same, in the middle of the overlap.
    half = OVERLAP // 2
    leaving = _poses(first, skeleton)[np.array(ends) - OVERLAP + half]
    arriving = _poses(second, skeleton)[np.array(starts) + half]
    costs = np.linalg.norm(leaving[:, None] - arriving[None], axis=-1).mean(axis=-1)
    end, start = np.unravel_index(costs.argmin(), costs.shape)
    return Cut(ends[end], starts[start], float(costs[end, start]))


def _poses(features: Features, skeleton: Skeleton) -> Float[np.ndarray, "T J 6"]:
    """Returns each frame's joint positions and scaled velocities, relative to the root's heading."""
    velocities = features[:, skeleton.layout.velocities].reshape(len(features), -1, 3)
    return np.concatenate([local_positions(features, skeleton), velocities * (skeleton.fps * VELOCITY_SECONDS)], axis=2)


def join_features(first: Features, second: Features, cut: Cut, *, overlap: int = OVERLAP) -> Features:
    """Returns raw features of one clip after another, T' = `cut.end` + U - `cut.start` - `overlap` frames.

    In the overlap, all features go smoothly from the first clip's to the second's. The root's velocity and turning
    speed are features, so path and heading continue without a jump. Bone lengths are not kept in the overlap:
    encode the joint positions of the result again.
    """
    share = fade((np.arange(overlap, dtype=np.float32) + 1) / (overlap + 1))[:, None]
    before = first[: cut.end]
    after = second[cut.start :]
    mixed = (1 - share) * before[cut.end - overlap :] + share * after[:overlap]
    return np.concatenate([before[: cut.end - overlap], mixed, after[overlap:]])


def fade_features(first: Features, second: Features, *, overlap: int) -> tuple[Features, Features]:
    """Returns raw features of two clips, the second of which follows the first, with all of their frames.

    In the `overlap` frames around the join, fewer if a clip is shorter, all features go smoothly from the first clip's
    to the second's. The first clip continues with its last frame there, and the second one begins with its first frame.
    """
    half = min(overlap, len(first), len(second)) // 2
    if not half:
        return first, second
    before = np.pad(first[-half:], ((0, half), (0, 0)), mode="edge")
    after = np.pad(second[:half], ((half, 0), (0, 0)), mode="edge")
    mixed = join_features(before, after, Cut(2 * half, 0, 0.0), overlap=2 * half)
    return np.concatenate([first[:-half], mixed[:half]]), np.concatenate([mixed[half:], second[half:]])


def place_positions(positions: Clip, pose: Pose, target: Pose, *, skeleton: Skeleton) -> Clip:
    """Returns a motion turned and moved on the ground, so that `pose` gets the place and the heading of `target`."""
    turn = quaternion_between(facing(pose, skeleton), facing(target, skeleton))
    return rotate_vectors(turn[None, None], positions - pose[0] * HORIZONTAL) + target[0] * HORIZONTAL


def replace_middle(
    head: Clip, generated: Clip, tail: Clip, *, first: int, last: int, fps: float, skeleton: Skeleton
) -> Clip:
    """Returns `head`, frames `first` to `last` of a generated motion, and `tail`, moved to where these have come.

    The generated motion has frames for head and tail, too. What they differ by at the joins, in pose and in velocity,
    is added to the middle and fades in it. Head and tail stay as they are. Bones, pelvis and chest of the middle are as
    in the frames beside it: if the motion turns as rigid bones, so does the result.

    Args:
        head: Frames before the join; may have none.
        generated: A motion whose frames before `first` are like the head's, and those from `last` like the tail's.
        tail: Frames after the middle; may have none.
        first: First frame of the middle.
        last: Frame after the middle.
        fps: Of all three.
        skeleton: Of all three.
    """
    if len(head):
        generated = place_positions(generated, generated[first - 1], head[-1], skeleton=skeleton)
    if len(tail):
        tail = place_positions(tail, tail[0], generated[last], skeleton=skeleton)
    middle = generated[first:last].astype(np.float64)
    count = min(round(FADE_SECONDS * fps), last - first)
    if len(head):
        moments = [Moment.at_end(frames, skeleton) for frames in (head, generated[:first])]
        middle = follow_on(middle, *moments, count=count, skeleton=skeleton)
    if len(tail):
        # Backward in time, the middle follows the tail.
        moments = [Moment.at_end(frames[2::-1], skeleton) for frames in (tail, generated[last:])]
        middle = follow_on(middle[::-1], *moments, count=count, skeleton=skeleton)[::-1]
    # Without frames beside it, the middle has the bones of its own first frame.
    beside = np.concatenate([head[-1:], tail[:1]]) if len(head) or len(tail) else middle[:1]
    middle = with_bones_of(beside, middle, skeleton)
    middle = feet_above(np.concatenate([head, generated, tail]), middle, skeleton)
    return np.concatenate([head, middle, tail]).astype(np.float32)


def join_positions(first: Clip, second: Clip, *, fps: float, skeleton: Skeleton) -> Clip:
    """Returns one motion after another, T + U - 1 frames.

    The second one is turned and moved, so that its first frame has the place and the heading of the last frame of the
    first one, which it replaces. What remains of the difference of these two poses, and of their velocities, fades out.
    Bones keep their lengths; those of another figure go from one length to the other.
    """
    moved = place_positions(second, second[0], first[-1], skeleton=skeleton)
    count = math.ceil(FADE_SECONDS * fps) - 1
    moments = [Moment.at_end(first, skeleton), Moment.at_start(moved, skeleton)]
    # Two parts of one motion differ by less than it accelerates. They become this motion again.
    apart = np.linalg.norm(first[-1] - moved[0]) + np.linalg.norm(moments[0].velocity - moments[1].velocity)
    usual = sum(float(np.linalg.norm(moment.acceleration)) for moment in moments)
    share = fade(np.array([2 * apart / max(usual, 1e-9) - 1]))
    moments = [moment._replace(velocity=share * moment.velocity) for moment in moments]
    after = follow_on(moved[1:], *moments, count=count, skeleton=skeleton)
    if len(after):
        beside = np.stack([first[-1], moved[1:][: count + 1][-1]])
        after[:count] = with_bones_of(beside, after[:count], skeleton)
        after[:count] = feet_above(np.concatenate([first, moved]), after[:count], skeleton)
    return np.concatenate([first, after]).astype(np.float32)


def ease_seams(positions: Clip, seams: Sequence[int], *, fps: float) -> Clip:
    """Returns a motion that is smoothed near the given frames, so that one action goes over into the next."""
    if not seams:
        return positions
    result = positions.copy()
    sigma = SEAM_SIGMA * fps
    radius = len(gaussian_kernel(sigma)) // 2
    reach = math.ceil(SEAM_SECONDS * fps)
    # A seam is between two frames.
    centers = np.array(seams) - 0.5
    for seam in seams:
        first = max(0, seam - reach)
        last = min(len(positions), seam + reach)
        # The filter reads beyond the frames that it changes.
        around = positions[max(0, first - radius) : last + radius]
        smooth = np.asarray(smooth_over_time(around.reshape(len(around), -1), sigma=sigma)).reshape(around.shape)
        # The nearest seam counts, where seams are closer than the time in which they fade.
        distance = np.abs(np.arange(first, last)[:, None] - centers[None]).min(axis=1)
        share = fade(1 - distance / (SEAM_SECONDS * fps))[:, None, None].astype(np.float32)
        skipped = first - max(0, first - radius)
        result[first:last] = (1 - share) * positions[first:last] + share * smooth[skipped : skipped + last - first]
    return result


def join_windows(windows: Iterable[Clip], *, count: int, overlap: int) -> Clip:
    """Returns the motion of `count` frames in windows that share `overlap` frames with the one before.

    In the middle half of the shared frames, one window fades into the other.
    """
    # Not in the outer quarters: there, one of the two windows was computed almost without what comes next to it.
    share = fade(2 * np.arange(overlap) / overlap - 0.5)[:, None, None].astype(np.float32)
    result: Clip | None = None
    first = 0
    for window in windows:
        if result is None:
            result = np.empty((count, *window.shape[1:]), np.float32)
        else:
            mixed = (1 - share) * result[first : first + overlap] + share * window[:overlap]
            window = np.concatenate([mixed, window[overlap:]])
        result[first : first + len(window)] = window
        first += len(window) - overlap
    assert result is not None, "there is no window"
    return result
