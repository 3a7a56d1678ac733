"""Training of the VQ-VAE and of the residual VQ-VAE: state, one pure step, and the data."""

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int, Key

from t2m_jax import losses
from t2m_jax.checkpoints.tokenizer import TrainedTokenizer, load_tokenizer, save_tokenizer_parts
from t2m_jax.config import flat_fields
from t2m_jax.data.banks.motions import MotionBank, Windows, batch_at, cuts_at, make_bank
from t2m_jax.data.folder import Clip, Dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.sources import CodeSource, Reconstruction
from t2m_jax.metrics.codes import code_usage, perplexity
from t2m_jax.models.rows import in_precision
from t2m_jax.models.vqvae import DECODER_PARTS, VqVae, VqVaeConfig, VqVaeOutput
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import skeleton_from_feature_dim
from t2m_jax.train.checks import check_same_function, open_training_data
from t2m_jax.train.config import compiled_config
from t2m_jax.train.experiment import Evaluation, Setup, Trainer, Validation
from t2m_jax.train.log import by_depth
from t2m_jax.train.optimizer import Metrics, descend, make_optimizer
from t2m_jax.train.program import Update
from t2m_jax.train.streams import plan_feed, stream_key, window_options
from t2m_jax.train.vqvae_config import TrainRvqVaeConfig, TrainVqVaeConfig, VqVaeStepConfig


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
def init_vqvae_state(config: VqVaeStepConfig, key: Key[Array, ""]) -> VqVaeState:
    """Returns the state before the first update; `key` is consumed."""
    motion = jnp.zeros((1, config.window, config.model.feature_dim))
    variables = VqVae(config.model).init(key, motion, train=False)
    opt_state = make_optimizer(config.optimizer).init(variables["params"])
    return VqVaeState(
        step=jnp.array(0, jnp.int32),
        params=variables["params"],
        codebook=variables.get("codebook", {}),
        batch_stats=variables.get("batch_stats", {}),
        opt_state=opt_state,
    )


class LossTerm(NamedTuple):
    """One term of the loss of reconstructions."""

    name: str
    """Its name in the log."""
    weight: float
    function: Callable[..., Float[Array, ""]]
    """From reconstruction, motion (both normalized) and mask to the value, without the weight."""


def loss_terms(config: VqVaeStepConfig, normalizer: Normalizer) -> list[LossTerm]:
    """Returns the terms of the loss that a config asks for; the normalizer is that of the motion."""
    skeleton = skeleton_from_feature_dim(config.model.feature_dim)
    kind: Any = {"kind": config.reconstruction}
    velocity: Any = {"velocity": config.velocity, "positions": skeleton.layout.positions}

    def in_meters(measure: Callable[..., Float[Array, ""]]) -> Callable[..., Float[Array, ""]]:
        return lambda *pair: skeleton.metres_per_unit * measure(*pair, skeleton=skeleton, normalizer=normalizer)

    in_features = functools.partial(losses.bone_loss, skeleton=skeleton)
    bones = in_features if config.bone_space == "normalized" else in_meters(losses.bone_loss)
    facing = functools.partial(losses.facing_loss, skeleton=skeleton, normalizer=normalizer)
    # These two are in every log, whatever their weights.
    always = [
        LossTerm("reconstruction", 1.0, functools.partial(losses.reconstruction_loss, **kind)),
        LossTerm("velocity", config.velocity_weight, functools.partial(losses.velocity_loss, **kind, **velocity)),
    ]
    steps, changes = (functools.partial(losses.world_loss, order=order) for order in (1, 2))
    # The order is part of the result: a sum of floats depends on it.
    optional = [
        LossTerm("acceleration", config.acceleration_weight, functools.partial(losses.acceleration_loss, **kind)),
        LossTerm("bones", config.bone_weight, bones),
        LossTerm("joints", config.joint_weight, in_meters(losses.joint_loss)),
        # An angle has no unit of length.
        LossTerm("facing", config.facing_weight, facing),
        LossTerm("world_velocity", config.world_velocity_weight, in_meters(steps)),
        LossTerm("world_acceleration", config.world_acceleration_weight, in_meters(changes)),
    ]
    return [*always, *(term for term in optional if term.weight)]


def vqvae_losses(output: VqVaeOutput, windows: Windows, config: VqVaeStepConfig, normalizer: Normalizer) -> Metrics:
    """Returns the terms of the loss and their weighted sum, `loss`, and how the codebook is used."""
    frames = output.reconstruction.shape[1]
    # The reconstruction ends with the last whole code.
    pair = (output.reconstruction.astype(jnp.float32), windows.motion[:, :frames], windows.mask[:, :frames])
    terms = loss_terms(config, normalizer)
    values = {term.name: term.function(*pair) for term in terms} | {"commitment": output.commitment_loss}
    weights = [*(term.weight for term in terms), config.commitment_weight]
    loss = functools.reduce(jnp.add, [weight * value for weight, value in zip(weights, values.values(), strict=True)])
    return {"loss": loss} | values | codebook_metrics(output)


def codebook_metrics(output: VqVaeOutput) -> Metrics:
    """Returns how a batch used the codebook: as a whole, and with residual quantization at each depth, too."""
    metrics = {"perplexity": perplexity(jnp.sum(output.code_counts, axis=0))}
    if len(output.expired) == 1:
        return metrics
    metrics["expired"] = jnp.sum(output.expired)
    metrics |= by_depth("perplexity", perplexity(output.code_counts))
    metrics |= by_depth("usage", code_usage(output.code_counts))
    return metrics | by_depth("residual_norm", output.residual_norms) | by_depth("expired", output.expired)


def vqvae_train_step(
    state: VqVaeState, windows: Windows, key: Key[Array, ""], *, config: VqVaeStepConfig, normalizer: Normalizer
) -> tuple[VqVaeState, Metrics]:
    """Returns the state after one update and the metrics before it.

    Args:
        state: The state before.
        windows: The batch.
        key: Consumed.
        config: Losses and optimizer.
        normalizer: Statistics of the windows, for bones in meters.
    """
    model = VqVae(config.model)
    # What is fixed is left out of the parameters that are differentiated, and put back for `apply`.
    fixed = {} if config.trained == "all" else {n: state.params[n] for n in state.params if n not in DECODER_PARTS}

    def measure(params: Any) -> tuple[Metrics, dict[str, Any]]:
        params = params | fixed
        # A codebook that is a parameter keeps its precision.
        computed = in_precision(params, config.precision) | {
            name: params[name] for name in params if name == "quantizer"
        }
        output, moved = model.apply(
            state.variables | {"params": computed},
            in_precision(windows.motion, config.precision),
            windows.mask,
            train=True,
            rngs={"codebook": key},
            mutable=["codebook", "batch_stats"],  # the codebook moves during the forward pass
        )
        fields = {name: moved.get(name, {}) for name in ("codebook", "batch_stats")}
        return vqvae_losses(output, windows, config, normalizer), fields if config.trained == "all" else {}

    after, metrics = descend(state, measure, config.optimizer)
    # Weight decay would change what has no gradient.
    return after._replace(params=after.params | fixed), metrics


def update(state: VqVaeState, bank: MotionBank, *, config: VqVaeStepConfig) -> tuple[VqVaeState, Metrics]:
    """Returns the state after one step on the batch of that step."""
    windows = batch_at(bank, step=state.step, **window_options(config.loop, "data", window=config.window))
    key = jax.random.fold_in(stream_key(config.loop.seed, "codebook"), state.step)
    return vqvae_train_step(state, windows, key, config=config, normalizer=Normalizer(bank.mean, bank.std))


@functools.partial(jax.jit, static_argnames="config")
def validate(state: VqVaeState, bank: MotionBank, batch: Int[Array, ""], *, config: VqVaeStepConfig) -> Metrics:
    """Returns the losses on a batch of held-out windows."""
    windows = batch_at(bank, step=batch, **window_options(config.loop, "validation", window=config.window))
    output = VqVae(config.model).apply(state.variables, windows.motion, windows.mask, train=False)
    return vqvae_losses(output, windows, config, Normalizer(bank.mean, bank.std))


def prepare(config: TrainVqVaeConfig, resume: bool) -> Setup:
    """Returns the setup of a training.

    Raises:
        UserError: The data do not fit the model, or a decoder is to be trained without a tokenizer in `init`.
    """
    dataset, normalizer = open_training_data(config, reader="the VQ-VAE", resume=resume)
    if config.trained == "decoder" and not resume:
        _check_codes_stay(config.init, config.model, normalizer)
    compiled = compiled_config(config)
    is_padded = config.short_clips == "pad"
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
        plan=plan_feed(cuts_at, config.loop, "data", window=config.window),
        optimizer=config.optimizer,
        frames_per_step=config.loop.batch_size * config.window,
        weights=lambda state: state.variables,
        write_parts=lambda run: save_tokenizer_parts(run, config.model, normalizer),
        start_from=lambda path: _weights_to_start_from(path, config),
        validation=make_validation(config, dataset, normalizer),
        evaluation=Evaluation(config.evaluation, config.model.downsample, source),
    )


def _weights_to_start_from(path: Path, config: TrainVqVaeConfig) -> dict[str, Any]:
    tokenizer = load_tokenizer(path)
    if config.init_parts == "all":
        check_same_function(f"{path}", tokenizer.config, config.model, ("activation", "dilation_growth", "norm"))
    return {"codebook": {}, "batch_stats": {}} | tokenizer.variables


def _check_codes_stay(init: Path | None, config: VqVaeConfig, normalizer: Normalizer) -> None:
    if init is None:
        raise UserError("trained: a decoder alone needs `init`, the tokenizer whose codes it reads")
    tokenizer = load_tokenizer(init)
    check_same_function(f"{init}", tokenizer.config, config, flat_fields(config))
    if not all(np.array_equal(*pair) for pair in zip(normalizer, tokenizer.normalizer, strict=True)):
        raise UserError(f"statistics: those of {init} are others, so codes would change; set it to `init`")


def make_validation(config: TrainVqVaeConfig, dataset: Dataset, normalizer: Normalizer) -> Validation | None:
    """Returns the validation on one pass over the validation split, None if it is empty or turned off."""
    shortest = config.model.downsample if config.short_clips == "pad" else config.window
    clips = dataset.clips("val", min_frames=shortest) if config.loop.validate_every else []
    if not clips:
        return None
    measure = functools.partial(validate, config=compiled_config(config))
    plan = plan_feed(cuts_at, config.loop, "validation", window=config.window)
    return Validation(make_bank(clips, normalizer), len(clips), measure, plan)


TRAINER = Trainer(
    config=TrainVqVaeConfig, prepare=prepare, next_command="t2m train gpt t2m-gpt/gpt --data {data} --vqvae {run}"
)
"""The entry point `vqvae`."""
RESIDUAL_TRAINER = Trainer(
    config=TrainRvqVaeConfig,
    prepare=prepare,
    next_command="t2m train hifigpt hifigpt/hifigpt --data {data} --vqvae {run}",
)
"""The entry point `rvqvae`."""
