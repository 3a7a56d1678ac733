"""Skeletons of other programs: what every file format needs to become the joints of HumanML3D."""

from t2m_jax.motion.rig.clip import BvhClip
from t2m_jax.motion.rig.resample import resample
from t2m_jax.motion.rig.retarget import retarget
from t2m_jax.motion.rig.rigs import Rig, load_rig, make_rig

__all__ = ["BvhClip", "Rig", "load_rig", "make_rig", "resample", "retarget"]
