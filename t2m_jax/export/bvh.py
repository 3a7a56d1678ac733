"""BVH files, by the writer of the motion package."""

from collections.abc import Sequence
from pathlib import Path

from t2m_jax.export.writing import only_motion
from t2m_jax.motion.bvh import save_bvh
from t2m_jax.motion.bvh.writer import Units
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig.tables import JointNames


def save_bvh_file(path: Path, motions: Sequence[Motion], *, names: JointNames = "lafan1", units: Units = "m") -> None:
    """Writes one motion as a BVH file; see `save_bvh`."""
    save_bvh(path, only_motion(path, motions), names=names, units=units)
