"""BVH files in and out."""

from t2m_jax.motion.bvh_clip import BvhClip
from t2m_jax.motion.bvh_reader import load_bvh
from t2m_jax.motion.bvh_writer import save_bvh

__all__ = ["BvhClip", "load_bvh", "save_bvh"]
