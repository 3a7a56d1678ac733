"""A check that several formats share."""

from collections.abc import Sequence
from pathlib import Path

from t2m_jax.errors import UserError
from t2m_jax.motion.motion import Motion


def only_motion(path: Path, motions: Sequence[Motion]) -> Motion:
    """Returns the only motion of `motions`, for formats that contain one.

    Raises:
        UserError: There is more than one motion, or none.
    """
    if len(motions) != 1:
        raise UserError(f"{path}: a {path.suffix} file holds exactly one motion, not {len(motions)}; use more files")
    return motions[0]
