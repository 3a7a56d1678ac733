"""Motions as arrays: skeletons, rotations, features, statistics, mirroring and `Motion`."""

from t2m_jax.motion.features import features_from_positions, positions_from_features, positions_from_rotations
from t2m_jax.motion.layout import FeatureLayout
from t2m_jax.motion.mirroring import mirror_caption, mirror_positions
from t2m_jax.motion.motion import Motion, motion_formats, save_motions
from t2m_jax.motion.normalizer import (
    Normalizer,
    load_normalizer,
    normalizer_from_clips,
    save_normalizer,
    weighted_normalizer,
)
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML, Skeleton, skeleton_from_feature_dim, skeleton_from_name

__all__ = [
    "HUMANML3D",
    "KIT_ML",
    "FeatureLayout",
    "Motion",
    "Normalizer",
    "Skeleton",
    "features_from_positions",
    "load_normalizer",
    "mirror_caption",
    "mirror_positions",
    "motion_formats",
    "normalizer_from_clips",
    "positions_from_features",
    "positions_from_rotations",
    "save_motions",
    "save_normalizer",
    "skeleton_from_feature_dim",
    "skeleton_from_name",
    "weighted_normalizer",
]
