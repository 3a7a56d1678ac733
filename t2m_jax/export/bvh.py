"""BVH through the writer of the motion package."""

import pathlib
from collections.abc import Sequence

from t2m_jax.export.writing import only_motion, whole_file
from t2m_jax.motion.bvh import save_bvh
from t2m_jax.motion.record import Motion


def save_bvh_file(path: pathlib.Path, motions: Sequence[Motion]) -> None:
    """Writes one motion as a BVH file."""
    motion = only_motion(path, motions)
    with whole_file(path) as part:
        save_bvh(part, motion)
