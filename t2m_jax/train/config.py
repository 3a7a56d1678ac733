"""One schema a training command."""

import dataclasses
from pathlib import Path

from t2m_jax.config import check_sizes
from t2m_jax.losses import ReconstructionKind
from t2m_jax.models.caption_encoder import CaptionEncoderConfig
from t2m_jax.models.motion_gpt import MotionGptConfig
from t2m_jax.models.vqvae import VqVaeConfig
from t2m_jax.train.schedules import OptimizerConfig


@dataclasses.dataclass(frozen=True, kw_only=True)
class LoopConfig:
    """How long to train and what to keep."""

    num_steps: int = 300_000
    """Updates in all."""
    batch_size: int = 256
    """Clips an update."""
    seed: int = 0
    """Start of every random choice: weights, order, windows, dropout."""
    log_every: int = 50
    """Updates a row of metrics."""
    validate_every: int = 1000
    """Updates between two looks at the validation split; 0 never looks."""
    checkpoint_every: int = 1000
    """Updates between two checkpoints; one is written at the end in any case."""
    keep_checkpoints: int = 2
    """How many of the newest checkpoints are kept."""

    def __post_init__(self) -> None:
        check_sizes(self, "num_steps", "batch_size", "keep_checkpoints")


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainVqVaeConfig:
    """Training of the VQ-VAE; the defaults are T2M-GPT's published command."""

    data: Path = Path("data/humanml3d")
    """Data-set folder."""
    run: Path = Path("runs/vqvae")
    """Run directory to write."""
    model: VqVaeConfig = VqVaeConfig()
    """Sizes."""
    window: int = 64
    """Frames of a training window; shorter clips are padded and masked."""
    root_weight: float = 25.0
    """How much larger the root's columns and the contacts are made before the VQ-VAE sees them. The original divides
    their standard deviations by 5 twice; without it heading and path drift."""
    reconstruction: ReconstructionKind = "l1_smooth"
    """Loss of the difference between motion and reconstruction."""
    position_weight: float = 0.5
    """Weight of the same loss over the joint positions alone (the original code's "velocity" loss)."""
    commitment_weight: float = 0.02
    """Weight of the commitment loss."""
    optimizer: OptimizerConfig = OptimizerConfig(warmup_steps=1000, milestones=(200_000,))
    """Optimiser and schedule."""
    loop: LoopConfig = LoopConfig()
    """Length, batch, seed, checkpoints."""

    def __post_init__(self) -> None:
        if self.window < self.model.downsample:
            raise ValueError(f"window: {self.window} is shorter than one code, {self.model.downsample} frames")


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainGptConfig:
    """Training of the GPT and its caption encoder; the defaults are T2M-GPT's published command."""

    data: Path = Path("data/humanml3d")
    """Data-set folder."""
    vqvae: Path = Path("runs/vqvae")
    """Run directory of the VQ-VAE that makes the codes."""
    run: Path = Path("runs/gpt")
    """Run directory to write."""
    model: MotionGptConfig = MotionGptConfig()
    """Sizes of the GPT."""
    caption_encoder: CaptionEncoderConfig = CaptionEncoderConfig(text_dim=512)
    """Sizes of the caption encoder."""
    keep_probability: float = 0.5
    """Chance that an input code is not replaced by a random one (1 - tau of the paper)."""
    drop_probability: float = 1 / 3
    """Chance that a motion loses one code at its head or tail."""
    optimizer: OptimizerConfig = OptimizerConfig(
        learning_rate=1e-4, milestones=(150_000,), betas=(0.5, 0.9), weight_decay=1e-6
    )
    """Optimiser and schedule."""
    loop: LoopConfig = LoopConfig(batch_size=128)
    """Length, batch, seed, checkpoints."""
