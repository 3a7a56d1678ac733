"""Checkpoints of the original PyTorch code: read without PyTorch, and written."""

from t2m_jax.checkpoints.official.export import export_official
from t2m_jax.checkpoints.official.load import load_evaluator, load_gpt, load_vqvae

__all__ = ["export_official", "load_evaluator", "load_gpt", "load_vqvae"]
