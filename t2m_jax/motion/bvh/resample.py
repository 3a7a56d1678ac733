"""Changing the frame rate of a clip."""

import dataclasses

import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.motion.bvh.clip import BvhClip
from t2m_jax.motion.rotations import matrix_from_quaternion, quaternion_from_matrix, slerp


def resample(clip: BvhClip, fps: float) -> BvhClip:
    """Returns `clip` at another frame rate. Frame k is the pose at k / `fps` seconds.

    Rotations are interpolated on the shortest arc, translations on a straight line. No frame is after the clip's end.
    """
    if not (np.isfinite(fps) and fps > 0):
        raise UserError(f"frames per second must be positive, not {fps}")
    if fps == clip.fps:
        return clip
    last = clip.num_frames - 1
    count = int(np.floor(last * fps / clip.fps + 1e-6)) + 1
    places = np.arange(count) * clip.fps / fps  # on the frame axis of the clip
    nearest = np.round(places)
    places = np.minimum(np.where(np.abs(places - nearest) < 1e-6, nearest, places), last)
    before = np.floor(places).astype(np.int64)
    after = np.minimum(before + 1, last)
    weights = (places - before)[:, None, None]
    translations = clip.translations[before] * (1 - weights) + clip.translations[after] * weights
    # New frames that coincide with a frame of the clip keep its matrices exactly. Only the others are interpolated.
    rotations = clip.rotations[before]
    between = np.flatnonzero(weights)
    if between.size:
        first = quaternion_from_matrix(clip.rotations[before[between]])
        second = quaternion_from_matrix(clip.rotations[after[between]])
        rotations[between] = matrix_from_quaternion(slerp(first, second, weights[between, :, 0]))
    return dataclasses.replace(clip, rotations=rotations, translations=translations.astype(np.float32), fps=float(fps))
