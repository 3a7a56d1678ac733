"""Training: one experiment for every model, from a config to a run directory."""

from t2m_jax.train.config import (
    EvaluationConfig,
    ExperimentConfig,
    GenerationEvaluationConfig,
    LoopConfig,
    ShardingConfig,
)
from t2m_jax.train.evaluator_config import TrainEvaluatorConfig
from t2m_jax.train.experiment import (
    Evaluation,
    Setup,
    Trainer,
    Validation,
    find_trainer,
    load_run_config,
    train,
)
from t2m_jax.train.gpt import TrainGptConfig
from t2m_jax.train.hifigpt import TrainHiFiGptConfig
from t2m_jax.train.optimizer import OptimizerConfig
from t2m_jax.train.presets import load_preset, preset_names
from t2m_jax.train.program import Update
from t2m_jax.train.vqvae_config import TrainRvqVaeConfig, TrainVqVaeConfig

__all__ = [
    "Evaluation",
    "EvaluationConfig",
    "ExperimentConfig",
    "GenerationEvaluationConfig",
    "LoopConfig",
    "OptimizerConfig",
    "Setup",
    "ShardingConfig",
    "TrainEvaluatorConfig",
    "TrainGptConfig",
    "TrainHiFiGptConfig",
    "TrainRvqVaeConfig",
    "TrainVqVaeConfig",
    "Trainer",
    "Update",
    "Validation",
    "find_trainer",
    "load_preset",
    "load_run_config",
    "preset_names",
    "train",
]
