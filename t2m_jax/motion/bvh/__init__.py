"""BVH files: reading, writing, and conversion to the joints of HumanML3D."""

from t2m_jax.motion.bvh.clip import BvhClip
from t2m_jax.motion.bvh.reader import load_bvh
from t2m_jax.motion.bvh.resample import resample
from t2m_jax.motion.bvh.retarget import retarget
from t2m_jax.motion.bvh.rigs import Rig, load_rig, make_rig
from t2m_jax.motion.bvh.writer import save_bvh

__all__ = ["BvhClip", "Rig", "load_bvh", "load_rig", "make_rig", "resample", "retarget", "save_bvh"]
