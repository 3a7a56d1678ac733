"""Motions as plain data for the page."""

import base64
import io
from typing import Any

from t2m_jax.errors import UserError
from t2m_jax.export.npz import write_npz
from t2m_jax.motion.formats import load_motion
from t2m_jax.motion.motion import Motion
from t2m_jax.serving.requests import MAX_TOTAL_SECONDS, motion_file


def motion_from_data(data: bytes, suffix: str) -> Motion:
    """Returns the motion in the bytes of a file.

    Raises:
        UserError: There is none, or it is too long. The message does not say where the file was.
    """
    with motion_file(data, suffix) as path:
        try:
            motion = load_motion(path)
        except UserError as error:
            raise UserError(str(error).replace(str(path), path.name)) from None
    if motion.seconds > MAX_TOTAL_SECONDS:  # at another frame rate, it could fill the memory
        raise UserError(f"motion.{suffix}: has {motion.seconds:g} seconds; at most {MAX_TOTAL_SECONDS:g} are read")
    return motion


def motion_record(motion: Motion) -> dict[str, Any]:
    """Returns a motion as plain data for the page, with the bytes of its `.npz` file in base64."""
    data = io.BytesIO()
    write_npz(data, motion, compress=False)
    return {
        "caption": motion.caption,
        "seed": motion.seed,
        "fps": motion.fps,
        "frames": motion.num_frames,
        "seconds": motion.seconds,
        "codes": None if motion.codes is None else motion.codes.tolist(),
        "part_starts": list(motion.part_starts),
        "part_captions": list(motion.part_captions),
        "npz": base64.b64encode(data.getvalue()).decode("ascii"),
    }
