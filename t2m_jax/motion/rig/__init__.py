"""Skeletons of other programs: what every file format needs to become the joints of HumanML3D."""

from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rig.retarget import retarget
from t2m_jax.motion.rig.rigs import load_rig

__all__ = ["RigClip", "load_rig", "retarget"]
