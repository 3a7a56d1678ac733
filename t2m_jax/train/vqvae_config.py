"""The configs of `t2m train vqvae` and `t2m train rvqvae`."""

import dataclasses
from pathlib import Path
from typing import ClassVar, Literal

from t2m_jax.field_checks import check_limits
from t2m_jax.losses import ReconstructionKind, VelocityKind
from t2m_jax.models.rows import Precision
from t2m_jax.models.vqvae import RvqVaeConfig, VqVaeConfig
from t2m_jax.train.config import MAX_WINDOW, EvaluationConfig, NormalizedConfig, StepConfig
from t2m_jax.train.optimizer import OptimizerConfig


@dataclasses.dataclass(frozen=True, kw_only=True)
class VqVaeStepConfig(StepConfig):
    """What a step of the VQ-VAE reads."""

    model: VqVaeConfig = VqVaeConfig()
    """Sizes."""
    window: int = 64
    """Frames of a training window."""
    reconstruction: ReconstructionKind = "l1_smooth"
    """Loss of the difference between motion and reconstruction."""
    velocity: VelocityKind = "joint_positions"
    """What the velocity loss compares: the joint positions a second time (the original's code), or the differences of
    consecutive frames (its paper)."""
    velocity_weight: float = 0.5
    """Weight of the velocity loss."""
    acceleration_weight: float = 0.0
    """Weight of the loss of second differences in time."""
    bone_weight: float = 0.0
    """Weight of the loss of bone vectors."""
    bone_space: Literal["metres", "normalized"] = "metres"
    """What bone vectors are measured in: meters, or the normalized features."""
    joint_weight: float = 0.0
    """Weight of the distance of the joints in meters, relative to the root."""
    facing_weight: float = 0.0
    """Weight of the angle between the directions in which hips and shoulders face, in radians."""
    world_velocity_weight: float = 0.0
    """Weight of the distance of the joints' steps in the world, in meters per frame. With it, paths drift less and feet
    slide less."""
    world_acceleration_weight: float = 0.0
    """Weight of the distance of the joints' changes of step in the world, in meters. With it, motion trembles less."""
    commitment_weight: float = 0.02
    """Weight of the commitment loss."""
    trained: Literal["all", "decoder"] = "all"
    """What is trained. With `decoder`, and `init`, all motion keeps its codes, so that generators still fit."""
    precision: Precision = "float32"
    """What products are computed in during training; the codebook is always in float32."""
    optimizer: OptimizerConfig = OptimizerConfig(warmup_steps=1000, milestones=(200_000,))
    """Optimizer and schedule."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_limits(self, window=MAX_WINDOW)
        if self.window < self.model.downsample:
            raise ValueError(f"window: {self.window} is shorter than one code, {self.model.downsample} frames")
        if self.trained == "decoder" and self.model.norm == "BN":
            raise ValueError("trained: a model with batch norm (model.norm: BN) cannot keep its codes")


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainVqVaeConfig(VqVaeStepConfig, NormalizedConfig):
    """Training of the VQ-VAE; the defaults are T2M-GPT's published command."""

    kind: ClassVar[str] = "vqvae"
    step: ClassVar[type[StepConfig]] = VqVaeStepConfig

    run: Path = Path("runs/vqvae")
    """Run directory to write."""
    short_clips: Literal["pad", "drop"] = "pad"
    """Clips shorter than a window: padded and masked, or left out as in the original."""
    evaluation: EvaluationConfig = EvaluationConfig()
    """Evaluation of reconstructions during training."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainRvqVaeConfig(TrainVqVaeConfig):
    """Training of the residual VQ-VAE; the defaults are those of T2M-HiFiGPT's paper (see `docs/hifigpt.md`)."""

    kind: ClassVar[str] = "rvqvae"

    run: Path = Path("runs/rvqvae")
    model: RvqVaeConfig = RvqVaeConfig()
    window: int = 32
    velocity: VelocityKind = "frame_difference"
    acceleration_weight: float = 0.5
    bone_weight: float = 1.0
    optimizer: OptimizerConfig = OptimizerConfig(betas=(0.9, 0.95), cosine=(22_000, 300_000))
