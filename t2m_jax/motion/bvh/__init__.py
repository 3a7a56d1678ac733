"""BVH files: reading and writing."""

from t2m_jax.motion.bvh.reader import load_bvh
from t2m_jax.motion.bvh.writer import save_bvh

__all__ = ["load_bvh", "save_bvh"]
