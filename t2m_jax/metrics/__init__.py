"""Metrics: functions of arrays."""

from t2m_jax.metrics.codes import code_usage, perplexity
from t2m_jax.metrics.positions import joint_errors, mpjpe

__all__ = ["code_usage", "joint_errors", "mpjpe", "perplexity"]
