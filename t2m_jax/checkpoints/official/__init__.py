"""Checkpoints of the original PyTorch code: reading them without PyTorch, and writing them."""

from t2m_jax.checkpoints.official.export import export_official
from t2m_jax.checkpoints.official.load import (
    evaluator_variables,
    gpt_variables,
    load_evaluator,
    load_gpt,
    load_vqvae,
    vqvae_variables,
)

__all__ = [
    "evaluator_variables",
    "export_official",
    "gpt_variables",
    "load_evaluator",
    "load_gpt",
    "load_vqvae",
    "vqvae_variables",
]
