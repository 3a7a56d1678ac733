"""Changing the frame rate of a clip."""

import dataclasses

from t2m_jax.motion import editing
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rotations import continuous_quaternions, matrix_from_quaternion, quaternion_from_matrix


def resample(clip: RigClip, fps: float) -> RigClip:
    """Returns `clip` at another frame rate. Frame k is the pose at k / `fps` seconds (see `editing.resample`).

    Rotations are filtered as quaternions, so that it does not matter how a file writes its angles.

    Raises:
        UserError: The rate is not a number above 0.
    """
    if fps == clip.fps:
        return clip
    quaternions = continuous_quaternions(quaternion_from_matrix(clip.rotations))
    return dataclasses.replace(
        clip,
        rotations=matrix_from_quaternion(editing.resample(quaternions, fps=clip.fps, new_fps=fps)),
        translations=editing.resample(clip.translations, fps=clip.fps, new_fps=fps),
        fps=float(fps),
        parts=(),
    )
