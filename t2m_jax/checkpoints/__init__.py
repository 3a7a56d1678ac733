"""Trained weights on disk: run directories, bundles, tokenizers, evaluators."""

from t2m_jax.checkpoints.bundle import Bundle, BundleConfig, load_bundle, save_bundle
from t2m_jax.checkpoints.evaluator import TrainedEvaluator, load_trained_evaluator, save_evaluator
from t2m_jax.checkpoints.model import load_model
from t2m_jax.checkpoints.tokenizer import TrainedTokenizer, load_tokenizer

__all__ = [
    "Bundle",
    "BundleConfig",
    "TrainedEvaluator",
    "TrainedTokenizer",
    "load_bundle",
    "load_model",
    "load_tokenizer",
    "load_trained_evaluator",
    "save_bundle",
    "save_evaluator",
]
