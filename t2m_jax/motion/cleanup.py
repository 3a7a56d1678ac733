"""A clean-up of decoded motion: less trembling, bones of constant length, and feet that stand still on the ground.

A decoder predicts each joint by itself. So joints tremble, bones stretch, and standing feet slide. Each step is a
function of positions alone and moves most joints by a few millimeters. A foot that would have to move by more than
`LARGEST_SHIFT` is left where it is. No knee turns faster than before. Positions are in meters with Y up.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from t2m_jax.masks import mask_from_lengths
from t2m_jax.motion.features import bone_vectors
from t2m_jax.motion.joining import join_windows
from t2m_jax.motion.legs import Frames, Joint, eased_bends, knee_bends, lengths_of, limit_speed, move_foot
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.motion.smoothing import smooth_over_clip
from t2m_jax.motion.torso import bone_matrices, calm_torso, make_hubs_rigid

SIGMA = 0.04
"""Standard deviation of the Gaussian that smooths; seconds."""
BONE_ROUNDS = 10
"""Rounds of moving joints toward the lengths of their bones."""
BONE_STEP = 1.6
"""Share of the error that a round corrects. Above 1, because the bones of a chain share a correction."""
CONTACT_HEIGHT = 0.05
"""A toe that is lower than this above the floor may stand; meters."""
CONTACT_SPEED = 1.0
"""A toe that is faster than this over the ground does not stand; meters per second."""
TRIMS = 3
"""Times that frames too far from the middle of a stand are left out of it."""
FADE = 4
"""Frames in which a lock begins and ends, at up to 20 frames a second; at higher rates, more in the same time."""
LARGEST_SHIFT = 0.06
"""A foot is not moved further than this; meters."""
OVERLAP_SECONDS = 2.0
"""Frames that two windows of a long motion share. A frame depends on the stands of feet around it."""
CLEANED_WINDOWS = 8
"""Windows that are cleaned together."""
CLEANED_SECONDS = 10.0
"""Longest windows of motion from a file."""
CLEANED_FRAMES = (40, 1200)
"""Fewest and most frames of these windows: a filter over time has a matrix of frames by frames."""

Clip = Float[Array, "T J 3"]
Bones = Float[Array, " _"]
"""Length of the bone that ends at each joint but the root, in meters."""


@functools.partial(jax.jit, static_argnames="skeleton")
def clean_positions(
    positions: Float[Array, "B T J 3"], lengths: Int[Array, " B"], *, skeleton: Skeleton
) -> Float[Array, "B T J 3"]:
    """Returns cleaned clips, in meters at the skeleton's frame rate; frames after the end of a clip have no meaning."""
    calm = _calm_clips(positions, lengths, skeleton=skeleton, bones=None)
    # Feet last: the other steps move joints a little, also those of a foot that must not slide.
    return _lock_clips(calm, positions, lengths, skeleton=skeleton)


@functools.partial(jax.jit, static_argnames="skeleton")
def _calm_clips(
    positions: Float[Array, "B T J 3"], lengths: Int[Array, " B"], *, skeleton: Skeleton, bones: Bones | None
) -> Float[Array, "B T J 3"]:
    """Returns clips that tremble less and whose bones have constant lengths."""
    chex.assert_shape([positions, lengths], [(None, None, skeleton.num_joints, 3), (len(positions),)])
    return jax.vmap(lambda clip, length: calm_clip(clip, length, skeleton, bones))(positions, lengths)


@functools.partial(jax.jit, static_argnames="skeleton")
def _lock_clips(
    calm: Float[Array, "B T J 3"], before: Float[Array, "B T J 3"], lengths: Int[Array, " B"], *, skeleton: Skeleton
) -> Float[Array, "B T J 3"]:
    """Returns calm clips that are rigid and whose feet are locked; `before` has the clips as they were given."""
    return jax.vmap(lambda calm, before, length: lock_clip(calm, before, length, skeleton))(calm, before, lengths)


def lock_clip(calm: Clip, before: Clip, length: Int[Array, ""], skeleton: Skeleton) -> Clip:
    """Returns a calm clip with a pelvis and a chest that keep their shapes, and feet that are locked.

    Args:
        calm: A clip after `calm_clip`; also several, joined.
        before: The same clip before any change.
        length: Frames of the clip.
        skeleton: Of the clip.
    """
    return lock_feet(make_hubs_rigid(calm, length, skeleton), length, skeleton, before=before)


def calm_clip(positions: Clip, length: Int[Array, ""], skeleton: Skeleton, bones: Bones | None = None) -> Clip:
    """Returns a clip that trembles less and whose bones have these lengths, by default the skeleton's."""
    smooth = smooth_over_clip(positions, length, sigma=SIGMA * skeleton.fps)
    return calm_torso(fix_bones(smooth, skeleton, bones), length, skeleton)


def fix_bones(positions: Clip, skeleton: Skeleton, lengths: Bones | None = None) -> Clip:
    """Returns positions with bones of these lengths, by default the skeleton's; the root stays where it is.

    Each round moves both ends of every bone toward its length, so that one wrong bone does not move a whole limb. The
    small rest is corrected from the root outwards.
    """
    # Row j of `ends` has -1 for the bones that begin at joint j, and 1 for the one that ends there.
    ends, chains = bone_matrices(skeleton)
    if lengths is None:
        lengths = jnp.array(skeleton.bone_lengths[1:], jnp.float32) * skeleton.metres_per_unit
    lengths = lengths[None, :, None]
    share = (0.5 * BONE_STEP / np.abs(ends).sum(axis=1))[None, :, None].astype(np.float32)

    def one_round(_: Any, positions: Clip) -> Clip:
        bones = jnp.einsum("jb,tjc->tbc", ends, positions)
        excess = bones * (1 - lengths / lengths_of(bones))
        return positions - share * jnp.einsum("jb,tbc->tjc", ends, excess)

    near = jax.lax.fori_loop(0, BONE_ROUNDS, one_round, positions)
    bones = jnp.einsum("jb,tjc->tbc", ends, near)
    return positions[:, :1] + jnp.einsum("jb,tbc->tjc", chains, bones * (lengths / lengths_of(bones)))


def lock_feet(
    positions: Clip, length: Int[Array, ""], skeleton: Skeleton, *, fps: float | None = None, before: Clip | None = None
) -> Clip:
    """Returns positions in which a toe that stands does not move over the ground; the legs bend as needed.

    Args:
        positions: One clip and padding.
        length: Frames of the clip.
        skeleton: Of the clip.
        fps: Frames per second; by default the skeleton's.
        before: The clip before any change: knees turn no faster than in it. By default `positions`.
    """
    before = positions if before is None else before
    fps = skeleton.fps if fps is None else fps
    fade = max(FADE, round(FADE * fps / 20))
    mask = mask_from_lengths(length[None], len(positions))[0]
    feet = np.array(skeleton.left_foot + skeleton.right_foot)
    low = floor_height(jnp.where(mask[:, None], positions[:, feet][..., 1], jnp.inf), 4 * length) + CONTACT_HEIGHT

    def moved_joints(leg: Int[Array, " 4"]) -> Float[Array, "T 3 3"]:
        hip, knee, ankle, toe = jnp.moveaxis(positions[:, leg], 1, 0)
        shift = lock_shift(toe, _standing(toe, mask, low, fps=fps), fade=fade)
        as_before = knee_bends(*jnp.moveaxis(before[:, leg[:3]], 1, 0))
        bends = limit_speed(eased_bends(hip, knee, ankle, shift), as_before, mask, fps=fps)
        return jnp.stack(move_foot(hip, knee, ankle, toe, shift, bends), axis=1)

    knees = [skeleton.parents[ankle] for ankle, _ in (skeleton.left_foot, skeleton.right_foot)]
    legs = np.column_stack([[skeleton.parents[knee] for knee in knees], knees, feet.reshape(2, 2)])
    moved = jax.vmap(moved_joints, out_axes=1)(jnp.asarray(legs))
    return positions.at[:, legs[:, 1:].ravel()].set(moved.reshape(len(positions), -1, 3))


def floor_height(heights: Float[Array, "T 4"], count: Int[Array, ""]) -> Float[Array, ""]:
    """Returns the height of the floor: of the lowest `count` heights of feet, the first percentile.

    It is not the lowest height: with one toe below the floor in one frame, all others would be too high to stand.
    """
    ordered = jnp.sort(heights.ravel())
    place = 0.01 * (count - 1)
    below = jnp.floor(place)
    pair = jax.lax.dynamic_slice(ordered, (below.astype(jnp.int32),), (2,))
    share = place - below
    return (1 - share) * pair[0] + share * pair[1]


def _standing(toe: Joint, mask: Frames, low: Float[Array, ""], *, fps: float) -> Frames:
    """Returns in which frames a toe stands: it is low and slow, without short gaps and single frames."""
    # The step from the last frame leads into padding.
    steps = jnp.where(mask[1:], lengths_of(jnp.diff(toe[:, ::2], axis=0))[:, 0] * fps, jnp.inf)
    speed = jnp.minimum(jnp.append(steps, steps[-1:]), jnp.concatenate([steps[:1], steps]))
    standing = (toe[:, 1] < low) & (speed < CONTACT_SPEED) & mask
    # A closing and an opening, as in image processing, each by this many frames on both sides.
    reach = max(1, round(fps / 20))
    # What is before the first frame and after the last one ends no stand.
    closed = _narrowed(_widened(standing, reach) | ~mask, reach)
    return _widened(_narrowed(closed | ~mask, reach) & mask, reach) & mask


def _widened(frames: Frames, reach: int) -> Frames:
    """Returns frames and their neighbors up to `reach` frames away."""
    return jax.lax.reduce_window(frames, False, jax.lax.bitwise_or, (2 * reach + 1,), (1,), "SAME")


def _narrowed(frames: Frames, reach: int) -> Frames:
    """Returns frames whose neighbors up to `reach` frames away are among them, too."""
    return ~_widened(~frames, reach)


def lock_shift(toe: Joint, standing: Frames, *, fade: int = FADE) -> Joint:
    """Returns how far to move a foot over the ground, so that it rests at one point while it stands.

    The point is the mean of the toe over one stand. Frames that are too far from it do not belong to the stand. The
    shift fades in during `fade` frames before a stand and out after it.
    """

    def trimmed(_: Any, standing: Frames) -> Frames:
        return standing & (lengths_of(_to_rest(toe, standing))[:, 0] <= LARGEST_SHIFT)

    standing = jax.lax.fori_loop(0, TRIMS, trimmed, standing)
    shift = _to_rest(toe, standing)
    frames = jnp.arange(len(standing))
    shift = jnp.where(lengths_of(shift) > LARGEST_SHIFT, 0.0, shift)
    # The last frame of a stand at or before each frame, and the first one at or after it.
    before = jax.lax.cummax(jnp.where(standing, frames, -fade - 1))
    after = jax.lax.cummin(jnp.where(standing, frames, len(frames) + fade), reverse=True)
    weights = _fade(frames - before, fade), _fade(after - frames, fade)
    faded = weights[0] * shift[before] + weights[1] * shift[jnp.minimum(after, len(frames) - 1)]
    return jnp.where(standing[:, None], shift, faded / jnp.maximum(weights[0] + weights[1], 1.0))


def _to_rest(toe: Joint, standing: Frames) -> Joint:
    """Returns the way over the ground from a toe to its mean over the stand; 0 in other frames."""
    begins = standing & ~jnp.concatenate([jnp.array([False]), standing[:-1]])
    stand = jnp.where(standing, jnp.cumsum(begins), 0)
    sums = jax.ops.segment_sum(jnp.append(toe, jnp.ones((len(toe), 1)), axis=1), stand, len(stand))
    mean = sums[:, :3] / jnp.maximum(sums[:, 3:], 1)
    return jnp.where(standing[:, None], mean[stand] - toe, 0.0) * jnp.array([[1.0, 0.0, 1.0]])


def _fade(distance: Int[Array, " T"], fade: int) -> Float[Array, "T 1"]:
    """Returns a factor that falls from 1 to 0 over `fade` frames."""
    return (0.5 + 0.5 * jnp.cos(jnp.pi * jnp.minimum(distance / (fade + 1), 1.0)))[:, None]


def clean_motion(positions: Float[np.ndarray, "T J 3"], *, fps: float, skeleton: Skeleton) -> np.ndarray:
    """Returns a cleaned motion of any length, rate and figure, whose bones get the medians of their lengths."""
    bones = np.median(np.linalg.norm(bone_vectors(positions, skeleton), axis=-1), axis=0)
    size = int(np.clip(round(CLEANED_SECONDS * fps), *CLEANED_FRAMES))
    return clean_long(positions, skeleton=dataclasses.replace(skeleton, fps=fps), size=size, bones=jnp.asarray(bones))


def clean_long(
    positions: Float[np.ndarray, "T J 3"], *, skeleton: Skeleton, size: int, bones: Bones | None = None
) -> Float[np.ndarray, "T J 3"]:
    """Returns a cleaned motion of any length, by overlapping windows of `size` frames with a cross-fade.

    A motion that fits into one window is cleaned as `generate` does it. Bones get these lengths, by default the
    skeleton's.
    """
    overlap = min(round(OVERLAP_SECONDS * skeleton.fps), size // 2)
    firsts = range(0, max(1, len(positions) - overlap), size - overlap)
    calm = functools.partial(_calm_clips, skeleton=skeleton, bones=bones)
    joined = join_windows(_calm_windows(positions, firsts, size, calm), count=len(positions), overlap=overlap)
    # Feet are locked in the whole motion: its floor is not that of a window, and a cross-fade could move a knee.
    padding = [(0, -len(positions) % size), (0, 0), (0, 0)]
    clips = (np.pad(clip, padding)[None].astype(np.float32) for clip in (joined, positions))
    return np.array(_lock_clips(*clips, np.array([len(positions)], np.int32), skeleton=skeleton))[0, : len(positions)]


def _calm_windows(
    positions: Float[np.ndarray, "T J 3"], firsts: Sequence[int], size: int, calm: Callable[..., Array]
) -> Iterator[Float[np.ndarray, "_ J 3"]]:
    """Yields the windows that begin at some frames, each smoothed by itself."""
    batch = CLEANED_WINDOWS if len(firsts) > 1 else 1
    for number in range(0, len(firsts), batch):
        windows = [positions[first : first + size] for first in firsts[number : number + batch]]
        padded: Any = np.zeros((batch, size, *positions.shape[1:]), np.float32)
        lengths = np.ones(batch, np.int32)
        for place, window in enumerate(windows):
            padded[place, : len(window)] = window
            lengths[place] = len(window)
        found = np.array(calm(padded, lengths))
        yield from (found[place, : len(window)] for place, window in enumerate(windows))
