"""Changing the frame rate of a clip."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from t2m_jax.errors import UserError
from t2m_jax.motion.bvh.clip import BvhClip
from t2m_jax.motion.rotations import matrix_from_quaternion, quaternion_from_matrix, slerp


def resample(clip: BvhClip, fps: float) -> BvhClip:
    """Returns `clip` at another frame rate, frame k being the pose at k / `fps` seconds.

    Rotations take the shortest arc between neighbouring frames, translations the straight line. The last
    frame is the last whose time lies within the clip.
    """
    if not (np.isfinite(fps) and fps > 0):
        raise UserError(f"frames per second must be positive, not {fps}")
    if fps == clip.fps:
        return clip
    sources = _source_frames(clip.num_frames, clip.fps, fps)
    before = np.floor(sources).astype(np.int64)
    after = np.minimum(before + 1, clip.num_frames - 1)
    weights = (sources - before)[:, None]
    translations = clip.translations[before] * (1 - weights[..., None]) + clip.translations[after] * weights[..., None]
    return dataclasses.replace(
        clip,
        rotations=_interpolate_rotations(clip.rotations, before, after, weights),
        translations=translations.astype(np.float32),
        fps=float(fps),
    )


def _source_frames(num_frames: int, source_fps: float, fps: float) -> Float[np.ndarray, " N"]:
    """Returns the place of each new frame on the source's frame axis, exact where it falls on a frame."""
    last = num_frames - 1
    count = int(np.floor(last * fps / source_fps + 1e-6)) + 1
    sources = np.arange(count) * source_fps / fps
    nearest = np.round(sources)
    sources = np.where(np.abs(sources - nearest) < 1e-6, nearest, sources)
    return np.minimum(sources, last)


def _interpolate_rotations(
    rotations: Float[np.ndarray, "T J 3 3"],
    before: Int[np.ndarray, " N"],
    after: Int[np.ndarray, " N"],
    weights: Float[np.ndarray, "N 1"],
) -> Float[np.ndarray, "N J 3 3"]:
    """Returns rotations between frames; those that fall on a frame are that frame's, to the last bit."""
    result = rotations[before]
    between = np.flatnonzero(weights[:, 0])
    if between.size:
        # Quaternions of single frames have arbitrary signs; slerp takes the shorter arc of the two.
        first = quaternion_from_matrix(rotations[before[between]])
        second = quaternion_from_matrix(rotations[after[between]])
        result[between] = matrix_from_quaternion(slerp(first, second, weights[between]))
    return result
