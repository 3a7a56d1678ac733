"""One schema a training command."""

import dataclasses
from pathlib import Path
from typing import Any, Literal, TypeVar

from t2m_jax.checkpoints.best import Sampling
from t2m_jax.checkpoints.bundle import CLIP_NAME, TextEncoderKind
from t2m_jax.config import check_sizes
from t2m_jax.losses import ReconstructionKind, TokenMean, VelocityKind
from t2m_jax.models.caption_encoder import CaptionEncoderConfig
from t2m_jax.models.motion_gpt import MotionGptConfig
from t2m_jax.models.vqvae import VqVaeConfig
from t2m_jax.train.optimizer import OptimizerConfig

Config = TypeVar("Config", bound=Any)
EvaluationMetric = Literal["fid", "matching_score", "r_precision_1", "r_precision_2", "r_precision_3"]
"""Metrics of which more, or less, is always better; diversity should be that of real motion."""


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
class EvaluationConfig:
    """Evaluation on the validation split during training, and which weights the run stands for."""

    evaluator: Path | None = None
    """Folder or run of an evaluator. Without one nothing is evaluated, and a run stands for its newest weights; with
    one, for the best that an evaluation has found."""
    every: int = 10_000
    """Updates between two evaluations; one more comes at the end."""
    metric: EvaluationMetric = "fid"
    """What the best weights are chosen by."""
    seed: int = 0
    """Start of what an evaluation draws: the same each time, so that figures of two steps compare."""

    def __post_init__(self) -> None:
        check_sizes(self, "every")
        if self.seed < 0:
            raise ValueError(f"seed: {self.seed} is below 0")


@dataclasses.dataclass(frozen=True, kw_only=True)
class GenerationEvaluationConfig(EvaluationConfig):
    """Evaluation during training of what generates from captions."""

    sampling: Sampling = "greedy"
    """How codes are chosen: the likeliest each time (the original, during training), or drawn (its final test)."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainVqVaeConfig:
    """Training of the VQ-VAE; the defaults are T2M-GPT's published command."""

    data: Path = Path("data/humanml3d")
    """Data-set folder."""
    data_fraction: float = 1.0
    """Share of the training clips that is used; a smaller share is part of a larger one."""
    run: Path = Path("runs/vqvae")
    """Run directory to write."""
    model: VqVaeConfig = VqVaeConfig()
    """Sizes."""
    window: int = 64
    """Frames of a training window."""
    short_clips: Literal["pad", "drop"] = "pad"
    """Clips shorter than a window: padded and masked, or left out as in the original."""
    root_weight: float = 25.0
    """How much larger the root's columns and the contacts are made before the VQ-VAE sees them. The original divides
    their standard deviations by 5 twice; without it heading and path drift."""
    reconstruction: ReconstructionKind = "l1_smooth"
    """Loss of the difference between motion and reconstruction."""
    velocity: VelocityKind = "joint_positions"
    """What the velocity loss compares: the joint positions once more (the original's code), or the differences of
    neighbouring frames (its paper)."""
    velocity_weight: float = 0.5
    """Weight of the velocity loss."""
    commitment_weight: float = 0.02
    """Weight of the commitment loss."""
    optimizer: OptimizerConfig = OptimizerConfig(warmup_steps=1000, milestones=(200_000,))
    """Optimiser and schedule."""
    loop: LoopConfig = LoopConfig()
    """Length, batch, seed, checkpoints."""
    evaluation: EvaluationConfig = EvaluationConfig()
    """Evaluation of reconstructions on the way."""

    def __post_init__(self) -> None:
        if self.window < self.model.downsample:
            raise ValueError(f"window: {self.window} is shorter than one code, {self.model.downsample} frames")
        check_fraction(self.data_fraction)


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainGptConfig:
    """Training of the GPT; the defaults are T2M-GPT's published command but for text encoder and cutting of clips."""

    data: Path = Path("data/humanml3d")
    """Data-set folder."""
    data_fraction: float = 1.0
    """Share of the training clips that is used; a smaller share is part of a larger one."""
    vqvae: Path = Path("runs/vqvae")
    """Run directory of the VQ-VAE that makes the codes."""
    run: Path = Path("runs/gpt")
    """Run directory to write."""
    model: MotionGptConfig = MotionGptConfig()
    """Sizes of the GPT."""
    text_encoder: TextEncoderKind = "caption_encoder"
    """What reads the captions: a small transformer trained along, or CLIP, which is left as it is."""
    clip: str = CLIP_NAME
    """CLIP model with `text_encoder: clip`: a folder or a name on the Hugging Face hub."""
    caption_encoder: CaptionEncoderConfig = CaptionEncoderConfig(text_dim=512)
    """Sizes of the caption encoder."""
    offsets: Literal["all", "one"] = "all"
    """Frames at which the first code of a clip may start: any that leave the same number of codes or one fewer, drawn
    anew each time, or one drawn for each clip before training (the original)."""
    timed_captions: Literal["encode", "slice"] = "encode"
    """Codes for a caption with times: of those frames by themselves, or cut out of the whole clip's (the original)."""
    tau: float | Literal["per_batch", "per_motion"] = 0.5
    """Share of the input codes that is replaced by random ones; or a share drawn from 0 to 1 for each batch (the
    original's code) or for each motion (its paper)."""
    corrupt_past_end: bool = True
    """Whether End and Pad inputs are replaced, too (the original's code)."""
    mean_over: TokenMean = "motions"
    """Mean of the loss: over motions of their means (the original's code), or over all tokens (its paper)."""
    drop_probability: float = 1 / 3
    """Chance that a motion loses one code at its head or tail."""
    optimizer: OptimizerConfig = OptimizerConfig(
        learning_rate=1e-4, milestones=(150_000,), betas=(0.5, 0.9), weight_decay=1e-6
    )
    """Optimiser and schedule."""
    loop: LoopConfig = LoopConfig(batch_size=128)
    """Length, batch, seed, checkpoints."""
    evaluation: GenerationEvaluationConfig = GenerationEvaluationConfig()
    """Evaluation of generated motion on the way."""

    def __post_init__(self) -> None:
        check_fraction(self.data_fraction)
        if isinstance(self.tau, float) and not 0 <= self.tau <= 1:
            raise ValueError(f"tau: {self.tau} is no share between 0 and 1")
        if self.text_encoder == "caption_encoder" and self.model.text_dim != self.caption_encoder.text_dim:
            raise ValueError(
                f"caption_encoder.text_dim: {self.caption_encoder.text_dim}, but the GPT reads model.text_dim "
                f"{self.model.text_dim}"
            )


def check_fraction(data_fraction: float) -> None:
    """Raises `ValueError` where a share of the data is none."""
    if not 0 < data_fraction <= 1:
        raise ValueError(f"data_fraction: {data_fraction} is no share above 0 and up to 1")


def computation(config: Config) -> Config:
    """Returns a training config with everything at its default that does not change what a step computes.

    Steps are compiled for it: runs that differ in places and lengths alone share their programs.
    """
    elsewhere = {
        field.name: field.default
        for field in dataclasses.fields(config)
        if field.type is Path or isinstance(field.default, EvaluationConfig)
    }
    loop = LoopConfig(batch_size=config.loop.batch_size, seed=config.loop.seed)
    return dataclasses.replace(config, loop=loop, **elsewhere)
