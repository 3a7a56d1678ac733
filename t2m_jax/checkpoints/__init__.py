"""Trained weights on disk: run directories, bundles, tokenizers, evaluators."""

from t2m_jax.checkpoints.audit import audit_model
from t2m_jax.checkpoints.best import Best, find_best
from t2m_jax.checkpoints.bundle import Bundle, BundleConfig, load_bundle, save_bundle
from t2m_jax.checkpoints.clip import TrainedClip, load_clip, save_clip
from t2m_jax.checkpoints.evaluator import TrainedEvaluator, load_trained_evaluator, save_evaluator
from t2m_jax.checkpoints.model import load_generator_run, load_model, load_runs
from t2m_jax.checkpoints.run import Checkpoints, RunInfo, run_info
from t2m_jax.checkpoints.sentence import TrainedSentenceEncoder, load_sentence_encoder
from t2m_jax.checkpoints.text_encoder import ClipReference, SentenceReference
from t2m_jax.checkpoints.tokenizer import TrainedTokenizer, load_tokenizer

__all__ = [
    "Best",
    "Bundle",
    "BundleConfig",
    "Checkpoints",
    "ClipReference",
    "RunInfo",
    "SentenceReference",
    "TrainedClip",
    "TrainedEvaluator",
    "TrainedSentenceEncoder",
    "TrainedTokenizer",
    "audit_model",
    "find_best",
    "load_bundle",
    "load_clip",
    "load_generator_run",
    "load_model",
    "load_runs",
    "load_sentence_encoder",
    "load_tokenizer",
    "load_trained_evaluator",
    "run_info",
    "save_bundle",
    "save_clip",
    "save_evaluator",
]
