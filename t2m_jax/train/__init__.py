"""Training: one experiment for every model, from a config to a run directory."""

from t2m_jax.train.config import ExperimentConfig, LoopConfig
from t2m_jax.train.curves import Run
from t2m_jax.train.evaluator_config import TrainEvaluatorConfig
from t2m_jax.train.experiment import Setup, Trainer, train
from t2m_jax.train.gpt import TrainGptConfig
from t2m_jax.train.hifigpt import TrainHiFiGptConfig
from t2m_jax.train.optimizer import OptimizerConfig
from t2m_jax.train.shipped import load_preset
from t2m_jax.train.vqvae import vqvae_train_step
from t2m_jax.train.vqvae_config import TrainRvqVaeConfig, TrainVqVaeConfig

__all__ = [
    "ExperimentConfig",
    "LoopConfig",
    "OptimizerConfig",
    "Run",
    "Setup",
    "TrainEvaluatorConfig",
    "TrainGptConfig",
    "TrainHiFiGptConfig",
    "TrainRvqVaeConfig",
    "TrainVqVaeConfig",
    "Trainer",
    "load_preset",
    "train",
    "vqvae_train_step",
]
