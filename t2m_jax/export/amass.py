"""`.npz` files in the layout of AMASS, for programs with the body model SMPL."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.export.formats import motion_of_clip
from t2m_jax.motion.amass import RATES, clip_from_amass
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.motion.smpl import smpl_from_motion, up_of_smpl

NUM_SHAPE = 16
"""Numbers of AMASS for the shape of a body (betas)."""
NUM_SOFT = 8
"""Numbers of AMASS for how its soft parts swing (dmpls)."""


def amass_arrays(path: Path, motion: Motion) -> dict[str, Any]:
    """Returns a motion by the keys of AMASS: the mean body, whose shape is zero.

    Raises:
        UserError: The motion has another skeleton.
    """
    if motion.skeleton.joint_names != HUMANML3D.joint_names:
        raise UserError(f"{path}: names smpl is for the skeleton {HUMANML3D.name}, not {motion.skeleton.name}")
    found = smpl_from_motion(motion)
    soft = np.zeros((motion.num_frames, NUM_SOFT))
    rates = dict.fromkeys(RATES, motion.fps)
    return {**found._asdict(), "betas": np.zeros(NUM_SHAPE), "dmpls": soft, "gender": "neutral", **rates}


def motion_from_amass(path: Path, archive: Mapping[str, np.ndarray]) -> Motion:
    """Returns the motion of an archive (see `clip_from_amass`).

    Raises:
        UserError: An entry is missing or is not as in AMASS.
    """
    clip = clip_from_amass(path, archive)
    return motion_of_clip(path, clip, rig=HUMANML3D.name, up=up_of_smpl(clip))
