"""Motion as arrays: skeletons, rotations, features, statistics, mirroring and the `Motion` record."""

from t2m_jax.motion.layout import FeatureLayout
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML, Skeleton, skeleton_from_feature_dim, skeleton_from_name

__all__ = [
    "HUMANML3D",
    "KIT_ML",
    "FeatureLayout",
    "Skeleton",
    "skeleton_from_feature_dim",
    "skeleton_from_name",
]
