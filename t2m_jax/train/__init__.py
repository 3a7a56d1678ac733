"""Training: one experiment for every model, from a config to a run directory."""

from t2m_jax.train.config import ExperimentConfig, LoopConfig
from t2m_jax.train.evaluator_config import TrainEvaluatorConfig
from t2m_jax.train.experiment import Setup, Trainer, train
from t2m_jax.train.optimizer import OptimizerConfig
from t2m_jax.train.vqvae_config import TrainVqVaeConfig

__all__ = [
    "ExperimentConfig",
    "LoopConfig",
    "OptimizerConfig",
    "Setup",
    "TrainEvaluatorConfig",
    "TrainVqVaeConfig",
    "Trainer",
    "train",
]
