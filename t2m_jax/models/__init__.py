"""The networks, as Linen modules with frozen configs; a module has one field, `config`."""

from t2m_jax.models.evaluator import Evaluator, EvaluatorConfig
from t2m_jax.models.hifigpt import HiFiGpt, HiFiGptConfig
from t2m_jax.models.motion_gpt import MotionGpt, MotionGptConfig
from t2m_jax.models.system import Part, make_module
from t2m_jax.models.vqvae import RvqVaeConfig, VqVae, VqVaeConfig

__all__ = [
    "Evaluator",
    "EvaluatorConfig",
    "HiFiGpt",
    "HiFiGptConfig",
    "MotionGpt",
    "MotionGptConfig",
    "Part",
    "RvqVaeConfig",
    "VqVae",
    "VqVaeConfig",
    "make_module",
]
