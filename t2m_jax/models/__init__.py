"""The networks, as Linen modules with frozen configs; a module has one field, `config`."""

from t2m_jax.models.evaluator import EvaluatorConfig
from t2m_jax.models.hifigpt import HiFiGpt
from t2m_jax.models.motion_gpt import MotionGpt
from t2m_jax.models.system import Part, make_module
from t2m_jax.models.vqvae import RvqVaeConfig, VqVae, VqVaeConfig

__all__ = ["EvaluatorConfig", "HiFiGpt", "MotionGpt", "Part", "RvqVaeConfig", "VqVae", "VqVaeConfig", "make_module"]
