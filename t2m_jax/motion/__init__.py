"""Motions as arrays: `Motion` and its files, the two skeletons, and features with their statistics."""

from t2m_jax.motion.changes import Changes
from t2m_jax.motion.character import Character, load_character
from t2m_jax.motion.features import features_from_positions, positions_from_features
from t2m_jax.motion.formats import save_motions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.normalizer import Normalizer, load_normalizer
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML, Skeleton

__all__ = [
    "HUMANML3D",
    "KIT_ML",
    "Changes",
    "Character",
    "Motion",
    "Normalizer",
    "Skeleton",
    "features_from_positions",
    "load_character",
    "load_normalizer",
    "positions_from_features",
    "save_motions",
]
