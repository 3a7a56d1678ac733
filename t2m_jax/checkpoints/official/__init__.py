"""Checkpoints of the original PyTorch code: read without PyTorch, and written."""

from t2m_jax.checkpoints.official.bundle import (
    OfficialEvaluatorFiles,
    OfficialFiles,
    load_official,
    load_official_evaluator,
    official_card,
)
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
    "OfficialEvaluatorFiles",
    "OfficialFiles",
    "evaluator_variables",
    "export_official",
    "gpt_variables",
    "load_evaluator",
    "load_gpt",
    "load_official",
    "load_official_evaluator",
    "load_vqvae",
    "official_card",
    "vqvae_variables",
]
