"""Metrics: functions of arrays. Random choices are index arrays, so that a result depends only on its arguments."""

from t2m_jax.metrics.codes import code_usage, perplexity
from t2m_jax.metrics.frechet import fid
from t2m_jax.metrics.positions import joint_errors, mpjpe, pa_mpjpe
from t2m_jax.metrics.quality import MotionErrors, MotionQuality, measure_errors, measure_quality
from t2m_jax.metrics.retrieval import label_bound, matching_score, r_precision
from t2m_jax.metrics.variety import diversity, multimodality

__all__ = [
    "MotionErrors",
    "MotionQuality",
    "code_usage",
    "diversity",
    "fid",
    "joint_errors",
    "label_bound",
    "matching_score",
    "measure_errors",
    "measure_quality",
    "mpjpe",
    "multimodality",
    "pa_mpjpe",
    "perplexity",
    "r_precision",
]
