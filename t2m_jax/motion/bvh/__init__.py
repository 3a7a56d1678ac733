"""BVH files in and out."""

from t2m_jax.motion.bvh.clip import BvhClip
from t2m_jax.motion.bvh.reader import load_bvh
from t2m_jax.motion.bvh.writer import save_bvh

__all__ = ["BvhClip", "load_bvh", "save_bvh"]
