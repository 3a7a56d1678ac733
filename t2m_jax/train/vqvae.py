"""Training of the VQ-VAE: config, state, one pure step, and the data it is trained on."""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, Key

from t2m_jax.checkpoints.tokenizer import TrainedTokenizer, load_tokenizer, save_tokenizer_parts
from t2m_jax.data.banks.host import FeedPlan
from t2m_jax.data.banks.motions import Cuts, MotionBank, Windows, batch_at, cuts_at, make_bank
from t2m_jax.data.folder import Clip, Dataset
from t2m_jax.evaluation.sources import CodeSource, Reconstruction
from t2m_jax.losses import ReconstructionKind, VelocityKind, reconstruction_loss, velocity_loss
from t2m_jax.metrics.codes import perplexity
from t2m_jax.models.rows import Precision, in_precision
from t2m_jax.models.vqvae import VqVae, VqVaeConfig, VqVaeOutput
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import skeleton_from_feature_dim
from t2m_jax.train.config import FROM_DATA, EvaluationConfig, ExperimentConfig, compiled_config
from t2m_jax.train.experiment import Evaluation, Setup, Trainer, Validation
from t2m_jax.train.optimizer import Metrics, OptimizerConfig, descend, make_optimizer
from t2m_jax.train.program import Update
from t2m_jax.train.statistics import open_training_data
from t2m_jax.train.streams import stream_key


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainVqVaeConfig(ExperimentConfig):
    """Training of the VQ-VAE; the defaults are T2M-GPT's published command."""

    kind: ClassVar[str] = "vqvae"

    run: Path = Path("runs/vqvae")
    """Run directory to write."""
    model: VqVaeConfig = VqVaeConfig()
    """Sizes."""
    window: int = 64
    """Frames of a training window."""
    short_clips: Literal["pad", "drop"] = "pad"
    """Clips shorter than a window: padded and masked, or left out as in the original."""
    statistics: str = FROM_DATA
    """Mean and standard deviation that normalize the motion: `data` for the data set's own, weighted by `root_weight`;
    or a folder or a file `mean.npy` (with `std.npy` beside it), or a model, used as they are."""
    root_weight: float = 25.0
    """By how much the root's columns and the contacts are scaled up for the VQ-VAE. The original divides their standard
    deviations by 5 twice; without it, heading and path drift."""
    reconstruction: ReconstructionKind = "l1_smooth"
    """Loss of the difference between motion and reconstruction."""
    velocity: VelocityKind = "joint_positions"
    """What the velocity loss compares: the joint positions a second time (the original's code), or the differences of
    consecutive frames (its paper)."""
    velocity_weight: float = 0.5
    """Weight of the velocity loss."""
    commitment_weight: float = 0.02
    """Weight of the commitment loss."""
    precision: Precision = "float32"
    """What products are computed in during training; the codebook is always in float32."""
    optimizer: OptimizerConfig = OptimizerConfig(warmup_steps=1000, milestones=(200_000,))
    """Optimizer and schedule."""
    evaluation: EvaluationConfig = EvaluationConfig()
    """Evaluation of reconstructions during training."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.root_weight > 0:
            raise ValueError(f"root_weight: {self.root_weight} is not above 0")
        if self.window < self.model.downsample:
            raise ValueError(f"window: {self.window} is shorter than one code, {self.model.downsample} frames")


class VqVaeState(NamedTuple):
    """Everything that an update changes."""

    step: Int[Array, ""]
    params: Any
    codebook: Any
    """Empty if the codebook is a parameter."""
    batch_stats: Any
    """Running statistics of norm `BN`; empty for other norms."""
    opt_state: optax.OptState

    @property
    def variables(self) -> dict[str, Any]:
        """The collections for the model's `apply`."""
        return {"params": self.params, "codebook": self.codebook, "batch_stats": self.batch_stats}


@functools.partial(jax.jit, static_argnames="config")
def init_vqvae_state(config: TrainVqVaeConfig, key: Key[Array, ""]) -> VqVaeState:
    """Returns the state before the first update; `key` is consumed."""
    motion = jnp.zeros((1, config.window, config.model.feature_dim))
    variables = VqVae(config.model).init(key, motion, train=False)
    opt_state = make_optimizer(config.optimizer).init(variables["params"])
    codebook, batch_stats = variables.get("codebook", {}), variables.get("batch_stats", {})
    return VqVaeState(jnp.array(0, jnp.int32), variables["params"], codebook, batch_stats, opt_state)


def vqvae_losses(output: VqVaeOutput, windows: Windows, config: TrainVqVaeConfig) -> Metrics:
    """Returns the terms of the loss and their weighted sum, `loss`."""
    positions = skeleton_from_feature_dim(config.model.feature_dim).layout.positions
    motion = windows.motion[:, : output.reconstruction.shape[1]]
    mask = windows.mask[:, : output.reconstruction.shape[1]]
    pair, kind = (output.reconstruction.astype(jnp.float32), motion, mask), config.reconstruction
    reconstruction = reconstruction_loss(*pair, kind=kind)
    velocity = velocity_loss(*pair, kind=kind, velocity=config.velocity, positions=positions)
    loss = reconstruction + config.velocity_weight * velocity + config.commitment_weight * output.commitment_loss
    return {
        "loss": loss,
        "reconstruction": reconstruction,
        "velocity": velocity,
        "commitment": output.commitment_loss,
        "perplexity": perplexity(output.code_counts),
    }


def vqvae_train_step(
    state: VqVaeState,
    windows: Windows,
    key: Key[Array, ""],
    *,
    config: TrainVqVaeConfig,
    noise: Float[Array, "2 K C"] | None = None,
) -> tuple[VqVaeState, Metrics]:
    """Returns the state after one update and the metrics before it.

    Args:
        state: The state before.
        windows: The batch.
        key: Consumed.
        config: Losses and optimizer.
        noise: Standard normal numbers for new codes, see `Quantizer`; drawn from `key` if None.
    """
    model = VqVae(config.model)

    def measure(params: Any) -> tuple[Metrics, dict[str, Any]]:
        # A codebook that is a parameter keeps its precision.
        computed = in_precision(params, config.precision) | {
            name: params[name] for name in params if name == "quantizer"
        }
        output, moved = model.apply(
            state.variables | {"params": computed},
            in_precision(windows.motion, config.precision),
            windows.mask,
            train=True,
            noise=noise,
            rngs={"codebook": key},
            mutable=["codebook", "batch_stats"],
        )
        fields = {name: moved.get(name, {}) for name in ("codebook", "batch_stats")}
        return vqvae_losses(output, windows, config), fields

    return descend(state, measure, config.optimizer)


def window_options(config: TrainVqVaeConfig, stream: str) -> dict[str, Any]:
    """Returns what decides, with the step, which windows are cut."""
    key = stream_key(config.loop.seed, stream)
    return {"key": key, "batch_size": config.loop.batch_size, "window": config.window}


def plan_feed(config: TrainVqVaeConfig, stream: str) -> FeedPlan:
    """Returns how the host cuts the windows of a stream."""

    def cuts(bank: MotionBank, step: Int[Array, ""]) -> Cuts:
        return cuts_at(bank, step=step, **window_options(config, stream))

    return FeedPlan(cuts, config.window)


def update(state: VqVaeState, bank: MotionBank, *, config: TrainVqVaeConfig) -> tuple[VqVaeState, Metrics]:
    """Returns the state after one step on the batch of that step."""
    model_key = stream_key(config.loop.seed, "codebook")
    windows = batch_at(bank, step=state.step, **window_options(config, "data"))
    return vqvae_train_step(state, windows, jax.random.fold_in(model_key, state.step), config=config)


@functools.partial(jax.jit, static_argnames="config")
def validate(state: VqVaeState, bank: MotionBank, batch: Int[Array, ""], *, config: TrainVqVaeConfig) -> Metrics:
    """Returns the losses on a batch of held-out windows."""
    windows = batch_at(bank, step=batch, **window_options(config, "validation"))
    output = VqVae(config.model).apply(state.variables, windows.motion, windows.mask, train=False)
    return vqvae_losses(output, windows, config)


def prepare(config: TrainVqVaeConfig, resume: bool) -> Setup:
    """Returns the setup of a training.

    Raises:
        UserError: The data do not fit the model.
    """
    dataset, normalizer = open_training_data(config, reader="the VQ-VAE", resume=resume)
    compiled, is_padded = compiled_config(config), config.short_clips == "pad"
    # The original takes every clip that is as long as a window, also those that its other stages find too short.
    shortest = max(config.model.downsample, dataset.info.min_frames) if is_padded else config.window
    clips = dataset.clips("train", min_frames=shortest, fraction=config.data_fraction)

    def source(state: VqVaeState, clips: Sequence[Clip]) -> CodeSource:
        return Reconstruction(TrainedTokenizer(config.model, state.variables, normalizer))

    return Setup(
        dataset=dataset,
        clips=clips,
        data=make_bank(clips, normalizer),
        init=lambda: init_vqvae_state(compiled, stream_key(config.loop.seed, "init")),
        update=Update(update, config=compiled),
        plan=plan_feed(config, "data"),
        optimizer=config.optimizer,
        frames_per_step=config.loop.batch_size * config.window,
        weights=lambda state: state.variables,
        write_parts=lambda run: save_tokenizer_parts(run, config.model, normalizer),
        start_from=lambda path: {"codebook": {}, "batch_stats": {}} | load_tokenizer(path).variables,
        validation=make_validation(config, dataset, normalizer),
        evaluation=Evaluation(config.evaluation, config.model.downsample, source),
    )


def make_validation(config: TrainVqVaeConfig, dataset: Dataset, normalizer: Normalizer) -> Validation | None:
    """Returns the validation on one pass over the validation split, None if it is empty or turned off."""
    shortest = config.model.downsample if config.short_clips == "pad" else config.window
    clips = dataset.clips("val", min_frames=shortest) if config.loop.validate_every else []
    if not clips:
        return None
    measure = functools.partial(validate, config=compiled_config(config))
    return Validation(make_bank(clips, normalizer), len(clips), measure, plan_feed(config, "validation"))


TRAINER = Trainer(config=TrainVqVaeConfig, prepare=prepare, next_command="t2m train gpt CONFIG --vqvae {run}")
"""The entry point `vqvae`."""
