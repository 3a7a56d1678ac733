"""Protocols that measure the motion of a model: tasks, sources of motion, metrics over repeats."""

from t2m_jax.evaluation.embedding import embed_plan_captions, embed_plan_motions
from t2m_jax.evaluation.inbetween import evaluate_inbetween
from t2m_jax.evaluation.monitor import held_out_metrics, open_held_out
from t2m_jax.evaluation.prompts.following import action_tests, evaluate_prompt_following
from t2m_jax.evaluation.prompts.groups import composed_tests, pace_tests
from t2m_jax.evaluation.prompts.manners import manner_tests
from t2m_jax.evaluation.protocols import PROTOCOLS, Plan, Protocol, find_protocol, make_plan
from t2m_jax.evaluation.reconstruction import evaluate_reconstruction
from t2m_jax.evaluation.run import evaluate
from t2m_jax.evaluation.sources import CodeSource, Generation, Reconstruction, make_generation
from t2m_jax.evaluation.task import EvaluationTask, make_task

__all__ = [
    "PROTOCOLS",
    "CodeSource",
    "EvaluationTask",
    "Generation",
    "Plan",
    "Protocol",
    "Reconstruction",
    "action_tests",
    "composed_tests",
    "embed_plan_captions",
    "embed_plan_motions",
    "evaluate",
    "evaluate_inbetween",
    "evaluate_prompt_following",
    "evaluate_reconstruction",
    "find_protocol",
    "held_out_metrics",
    "make_generation",
    "make_plan",
    "make_task",
    "manner_tests",
    "open_held_out",
    "pace_tests",
]
