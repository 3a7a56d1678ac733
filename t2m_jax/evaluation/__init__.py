"""Protocols that measure the motion of a model: tasks, sources of motion, metrics over repeats."""

from t2m_jax.evaluation.embedding import embed_plan_captions, embed_plan_motions
from t2m_jax.evaluation.prompts.following import action_tests, evaluate_prompt_following
from t2m_jax.evaluation.protocols import PROTOCOLS, Protocol, find_protocol
from t2m_jax.evaluation.reconstruction import evaluate_reconstruction
from t2m_jax.evaluation.run import evaluate
from t2m_jax.evaluation.sources import make_generation
from t2m_jax.evaluation.task import EvaluationTask, make_task

__all__ = [
    "PROTOCOLS",
    "EvaluationTask",
    "Protocol",
    "action_tests",
    "embed_plan_captions",
    "embed_plan_motions",
    "evaluate",
    "evaluate_prompt_following",
    "evaluate_reconstruction",
    "find_protocol",
    "make_generation",
    "make_task",
]
