"""Training of the GPT, together with its caption encoder if it has one: inputs and targets, state, one pure step."""

import dataclasses
import functools
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from t2m_jax.data.banks.codes import Captions, CodeBank
from t2m_jax.data.banks.order import row_keys, split_each
from t2m_jax.devices import own_rows, split_rows
from t2m_jax.field_checks import check_shares
from t2m_jax.losses import TokenMean, token_accuracy, token_loss, token_weights
from t2m_jax.models.motion_gpt import MotionGpt, MotionGptConfig
from t2m_jax.models.rows import Precision, apply_rows, in_precision
from t2m_jax.train import generator
from t2m_jax.train.config import LoopConfig, StepConfig
from t2m_jax.train.generator_config import GeneratorStepConfig, TrainGeneratorConfig
from t2m_jax.train.optimizer import Metrics, OptimizerConfig, TrainState, first_state
from t2m_jax.train.streams import stream_key


@dataclasses.dataclass(frozen=True, kw_only=True)
class GptStepConfig(GeneratorStepConfig):
    """What a step of the GPT reads."""

    model: MotionGptConfig = MotionGptConfig()
    """Sizes of the GPT."""
    tau: float | Literal["per_batch", "per_motion"] = 0.5
    """Share of the input codes that is replaced by random ones; or a share drawn from 0 to 1 for each batch (the
    original's code) or for each motion (its paper)."""
    corrupt_past_end: bool = True
    """Whether End and Pad inputs are replaced too (the original's code)."""
    mean_over: TokenMean = "motions"
    """Mean of the loss: over motions of their means (the original's code), or over all tokens (its paper)."""
    drop_probability: float = 1 / 3
    """Probability that a motion loses one code at its head or tail."""
    optimizer: OptimizerConfig = OptimizerConfig(
        learning_rate=1e-4, milestones=(150_000,), betas=(0.5, 0.9), weight_decay=1e-6
    )
    """Optimizer and schedule."""
    loop: LoopConfig = LoopConfig(batch_size=128)
    """Length, batch, seed, checkpoints."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_shares(self, "drop_probability")
        if isinstance(self.tau, float):
            check_shares(self, "tau")


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainGptConfig(GptStepConfig, TrainGeneratorConfig):
    """Training of the GPT; the defaults are T2M-GPT's published command, except for text encoder and offsets."""

    kind: ClassVar[str] = "gpt"
    step: ClassVar[type[StepConfig]] = GptStepConfig

    run: Path = Path("runs/gpt")
    """Run directory to write."""


class Targets(NamedTuple):
    """What the GPT predicts: the codes of each motion, then End, then Pad."""

    tokens: Int[Array, "B L"]
    code_lengths: Int[Array, " B"]


def make_targets(codes: Int[Array, "B N"], code_lengths: Int[Array, " B"], *, config: MotionGptConfig) -> Targets:
    """Returns `block_size` targets per motion: its codes, End (= num_codes), then Pad (= num_codes + 1).

    Motions are cut after `block_size - 1` codes.
    """
    block_size = config.block_size
    code_lengths = jnp.minimum(code_lengths, config.max_codes)
    room = block_size - codes.shape[1]
    padded = jnp.pad(codes, ((0, 0), (0, max(room, 0))))[:, :block_size]
    # Every motion gets an End, also one that was cut.
    position = jnp.arange(block_size)[None]
    tokens = jnp.where(position < code_lengths[:, None], padded, config.end_token + 1)
    return Targets(jnp.where(position == code_lengths[:, None], config.end_token, tokens), code_lengths)


def drop_one_code(
    codes: Int[Array, "B N"], code_lengths: Int[Array, " B"], drop: Bool[Array, " B"], *, at_head: Bool[Array, " B"]
) -> tuple[Int[Array, "B N"], Int[Array, " B"]]:
    """Returns codes and lengths. Where `drop` is True, the first or the last code is removed.

    As in the original, a motion of one code then has none, so that its only target is End.
    """
    # Without its last code a motion is only shorter; without its first, all codes move to the left.
    shifted = jnp.where((drop & at_head)[:, None], jnp.roll(codes, -1, axis=1), codes)
    return shifted, code_lengths - drop


class Corruption(NamedTuple):
    """Inputs that are replaced in training, and their replacements."""

    keep: Bool[Array, "B L"]
    replacements: Int[Array, "B L"]

    def apply(self, tokens: Int[Array, "B L"]) -> Int[Array, "B L"]:
        """Returns the tokens, replaced where `keep` is False."""
        return jnp.where(self.keep, tokens, self.replacements)


def draw_corruption(
    tokens: Int[Array, "B L"],
    keys: Key[Array, " B"],
    *,
    tau: float | Float[Array, ""] | Literal["per_motion"],
    num_codes: int,
    past_end: bool,
) -> Corruption:
    """Returns a corruption that replaces each token, with probability `tau`, by a code from a uniform distribution.

    Args:
        tokens: Codes, End (= `num_codes`) and Pad.
        keys: One per motion; consumed.
        tau: The probability. `per_motion` draws one from 0 to 1 for each motion.
        num_codes: Number of codes to draw from. The right code may be drawn, too.
        past_end: Whether End and Pad may be replaced, as in the original code.
    """

    def draw(key: Key[Array, ""]) -> tuple[Bool[Array, " L"], Int[Array, " L"]]:
        share_key, replace_key, code_key = jax.random.split(key, 3)
        share = jax.random.uniform(share_key) if isinstance(tau, str) else tau
        # The inputs alone are replaced. Targets stay what they are, so that the model learns to recover from errors.
        keep = ~(jax.random.uniform(replace_key, tokens.shape[1:]) < share)
        return keep, jax.random.randint(code_key, tokens.shape[1:], 0, num_codes)

    keep, replacements = jax.vmap(draw)(keys)
    return Corruption(keep if past_end else keep | (tokens >= num_codes), replacements)


class GptBatch(NamedTuple):
    """What the GPT reads and predicts. The weights are those of the means over the global batch."""

    inputs: Int[Array, "B N"]
    tokens: Int[Array, "B L"]
    loss_weights: Float[Array, "B L"]
    accuracy_weights: Float[Array, "B L"]
    captions: Captions
    dropout_keys: Key[Array, "B 2"] | None
    """Of caption encoder and GPT; None turns dropout off."""


@functools.partial(jax.jit, static_argnames="config")
def init_gpt_state(config: GptStepConfig, key: Key[Array, ""]) -> TrainState:
    """Returns the state before the first update; `key` is consumed.

    Its `params` have the entries `gpt` and, if it is trained too, `caption_encoder`.
    """
    gpt_key, caption_key = jax.random.split(key)
    tokens = jnp.zeros((1, config.model.max_codes), jnp.int32)
    text = jnp.zeros((1, config.model.text_dim))
    params = {"gpt": MotionGpt(config.model).init(gpt_key, tokens, text, train=False)["params"]}
    params |= generator.init_caption_encoder(config, caption_key)
    return first_state(params, config.optimizer)


def make_gpt_batch(
    targets: Targets,
    captions: Captions,
    *,
    config: GptStepConfig,
    inputs: Int[Array, "B N"] | None = None,
    dropout_keys: Key[Array, "B 2"] | None = None,
) -> GptBatch:
    """Returns a batch for the GPT; without `inputs` they are the targets but for the last."""
    length = targets.tokens.shape[1]
    loss_weights = token_weights(targets.code_lengths, length, mean_over=config.mean_over)
    # The original counts right tokens over all tokens, whatever its loss is a mean of.
    accuracy_weights = token_weights(targets.code_lengths, length, mean_over="tokens")
    inputs = targets.tokens[:, :-1] if inputs is None else inputs
    return GptBatch(inputs, targets.tokens, loss_weights, accuracy_weights, captions, dropout_keys)


def gpt_metrics(params: Any, batch: GptBatch, *, config: GptStepConfig, precision: Precision = "float32") -> Metrics:
    """Returns loss and accuracy of a batch, or the shares of a part of a batch in them."""
    params, captions = in_precision((params, batch.captions), precision)
    keys = (None, None) if batch.dropout_keys is None else (batch.dropout_keys[:, 0], batch.dropout_keys[:, 1])
    text = generator.embed_captions(params, captions, keys[0], config=config)
    model = MotionGpt(config.model, remat=config.remat)
    logits = apply_rows(model, {"params": params["gpt"]}, batch.inputs, text, keys=keys[1])
    return {
        "loss": token_loss(logits, batch.tokens, batch.loss_weights),
        "accuracy": token_accuracy(logits, batch.tokens, batch.accuracy_weights),
    }


def gpt_train_step(state: TrainState, batch: GptBatch, *, config: GptStepConfig) -> tuple[TrainState, Metrics]:
    """Returns the state after one update and the metrics before it."""
    measure = functools.partial(gpt_metrics, config=config, precision=config.precision)
    return generator.descend_trained(state, measure, batch, config=config, generator="gpt")


def training_batch(bank: CodeBank, step: Int[Array, ""], *, config: GptStepConfig) -> GptBatch:
    """Returns the batch of an update: some motions lose a code at one end, and some inputs are replaced."""
    seed = config.loop.seed
    rows = own_rows(config.loop.batch_size)
    # Each row has its own key, so that a batch is the same on one and on many devices.
    keys = {name: row_keys(stream_key(seed, name), step, rows) for name in ("drop", "corruption", "dropout")}
    codes, code_lengths, captions = generator.codes_at(bank, "data", step, config=config)
    drop_keys, head_keys = split_each(keys["drop"], 2)
    drop = jax.vmap(lambda key: jax.random.bernoulli(key, config.drop_probability))(drop_keys)
    at_head = jax.vmap(jax.random.bernoulli)(head_keys)
    codes, code_lengths = drop_one_code(codes[:, :, 0], code_lengths, drop, at_head=at_head)
    targets = make_targets(codes, code_lengths, config=config.model)
    tau: Any = config.tau
    if tau == "per_batch":  # one key for all rows and devices
        tau = jax.random.uniform(jax.random.fold_in(stream_key(seed, "tau"), step))
    # Teacher forcing: the token at each place is predicted from the true ones before it, but for the corruption.
    inputs = targets.tokens[:, :-1]
    corruption = draw_corruption(
        inputs, keys["corruption"], tau=tau, num_codes=config.model.num_codes, past_end=config.corrupt_past_end
    )
    dropout_keys = jnp.stack(split_each(keys["dropout"], 2), axis=1)
    inputs = corruption.apply(inputs)
    return split_rows(make_gpt_batch(targets, captions, config=config, inputs=inputs, dropout_keys=dropout_keys))


def update(state: TrainState, bank: CodeBank, *, config: GptStepConfig) -> tuple[TrainState, Metrics]:
    """Returns the state after one step on the batch of that step."""
    return gpt_train_step(state, training_batch(bank, state.step, config=config), config=config)


@functools.partial(jax.jit, static_argnames="config")
def validate(state: TrainState, bank: CodeBank, step: Int[Array, ""], *, config: GptStepConfig) -> Metrics:
    """Returns loss and accuracy on a batch of held-out motions, with clean inputs."""
    codes, code_lengths, captions = generator.codes_at(bank, "validation", step, config=config)
    targets = make_targets(codes[:, :, 0], code_lengths, config=config.model)
    return gpt_metrics(state.params, make_gpt_batch(targets, captions, config=config), config=config)


TRAINER = generator.make_trainer(TrainGptConfig, generator.GeneratorSteps(init_gpt_state, update, validate))
"""The entry point `gpt`."""
