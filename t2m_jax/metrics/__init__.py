"""Metrics: functions of arrays. Random choices are index arrays, so that a result depends only on its arguments."""

from t2m_jax.metrics.codes import code_usage, perplexity
from t2m_jax.metrics.frechet import fid
from t2m_jax.metrics.positions import joint_errors, mpjpe
from t2m_jax.metrics.quality import measure_quality
from t2m_jax.metrics.retrieval import matching_score, r_precision
from t2m_jax.metrics.variety import diversity, multimodality

__all__ = [
    "code_usage",
    "diversity",
    "fid",
    "joint_errors",
    "matching_score",
    "measure_quality",
    "mpjpe",
    "multimodality",
    "perplexity",
    "r_precision",
]
