"""Training of the GPT, together with its caption encoder if it has one: state and one pure step."""

import dataclasses
import functools
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, Key

from t2m_jax.data.banks.codes import Captions, CodeBank, CodeBatch, code_batch_at
from t2m_jax.losses import TokenMean, token_loss
from t2m_jax.models.motion_gpt import MotionGpt, MotionGptConfig
from t2m_jax.train.config import LoopConfig
from t2m_jax.train.experiment import Setup, Trainer
from t2m_jax.train.generator import (
    GeneratorSteps,
    TrainGeneratorConfig,
    embed_captions,
    init_caption_encoder,
    prepare_generator,
    resolve_generator,
)
from t2m_jax.train.optimizer import Metrics, OptimizerConfig, TrainState, descend, first_state
from t2m_jax.train.streams import stream_key
from t2m_jax.train.targets import Corruption, Targets, draw_corruption, drop_one_code, make_targets


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainGptConfig(TrainGeneratorConfig):
    """Training of the GPT; the defaults are T2M-GPT's published command, except for text encoder and offsets."""

    kind: ClassVar[str] = "gpt"

    run: Path = Path("runs/gpt")
    """Run directory to write."""
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
        if isinstance(self.tau, float) and not 0 <= self.tau <= 1:
            raise ValueError(f"tau: {self.tau} is not a share between 0 and 1")


class GptBatch(NamedTuple):
    """Targets and their captions."""

    targets: Targets
    captions: Captions


@functools.partial(jax.jit, static_argnames="config")
def init_gpt_state(config: TrainGptConfig, key: Key[Array, ""]) -> TrainState:
    """Returns the state before the first update; `key` is consumed.

    Its `params` have the entries `gpt` and, if it is trained too, `caption_encoder`.
    """
    gpt_key, caption_key = jax.random.split(key)
    tokens = jnp.zeros((1, config.model.max_codes), jnp.int32)
    text = jnp.zeros((1, config.model.text_dim))
    params = {"gpt": MotionGpt(config.model).init(gpt_key, tokens, text, train=False)["params"]}
    params |= init_caption_encoder(config, caption_key)
    return first_state(params, config.optimizer)


def gpt_metrics(
    params: Any,
    batch: GptBatch,
    keys: Key[Array, "3"] | None,
    *,
    config: TrainGptConfig,
    corruption: Corruption | None = None,
) -> Metrics:
    """Returns loss and accuracy.

    Args:
        params: Of the state.
        batch: Targets and captions.
        keys: Of corruption, caption encoder and GPT, as in training; None for clean inputs without dropout.
        config: Sizes and loss.
        corruption: Used instead of one that is drawn.
    """
    inputs, rngs, caption_key = batch.targets.tokens[:, :-1], {}, None
    if keys is not None:
        caption_key, rngs = keys[1], {"dropout": keys[2]}
        num_codes, past_end = config.model.num_codes, config.corrupt_past_end
        drawn = draw_corruption(inputs, keys[0], tau=config.tau, num_codes=num_codes, past_end=past_end)
        inputs = (corruption or drawn).apply(inputs)
    text = embed_captions(params, batch.captions, caption_key, config=config)
    logits = MotionGpt(config.model).apply({"params": params["gpt"]}, inputs, text, train=keys is not None, rngs=rngs)
    loss, accuracy = token_loss(logits, batch.targets.tokens, batch.targets.code_lengths, mean_over=config.mean_over)
    return {"loss": loss, "accuracy": accuracy}


def gpt_train_step(
    state: TrainState,
    batch: GptBatch,
    key: Key[Array, ""],
    *,
    config: TrainGptConfig,
    corruption: Corruption | None = None,
) -> tuple[TrainState, Metrics]:
    """Returns the state after one update and the metrics before it; `key` is consumed.

    `corruption` is used instead of one that is drawn.
    """
    keys = jax.random.split(key, 3)

    def measure(params: Any) -> tuple[Metrics, dict[str, Any]]:
        return gpt_metrics(params, batch, keys, config=config, corruption=corruption), {}

    return descend(state, measure, config.optimizer)


def make_batch(batch: CodeBatch, key: Key[Array, ""] | None, *, config: TrainGptConfig) -> GptBatch:
    """Returns targets and captions; with a key (consumed), some motions lose a code at one end."""
    codes, code_lengths = batch.codes[:, :, 0], batch.code_lengths
    if key is not None:
        drop_key, head_key = jax.random.split(key)
        drop = jax.random.bernoulli(drop_key, config.drop_probability, code_lengths.shape)
        at_head = jax.random.bernoulli(head_key, 0.5, code_lengths.shape)
        codes, code_lengths = drop_one_code(codes, code_lengths, drop, at_head=at_head)
    targets = make_targets(codes, code_lengths, num_codes=config.model.num_codes, block_size=config.model.block_size)
    return GptBatch(targets, batch.captions)


def batch_at(bank: CodeBank, stream: str, step: Int[Array, ""], *, config: TrainGptConfig) -> CodeBatch:
    """Returns the codes of a step of a stream."""
    key = stream_key(config.loop.seed, stream)
    return code_batch_at(bank, key, step, batch_size=config.loop.batch_size, max_codes=config.model.max_codes)


@functools.partial(jax.jit, static_argnames="config", donate_argnums=0)
def update(state: TrainState, bank: CodeBank, *, config: TrainGptConfig) -> tuple[TrainState, Metrics]:
    """Returns the state after one step on the batch of that step; `state` is donated."""
    keys = (stream_key(config.loop.seed, name) for name in ("drop", "model"))
    drop_key, model_key = (jax.random.fold_in(key, state.step) for key in keys)
    batch = make_batch(batch_at(bank, "data", state.step, config=config), drop_key, config=config)
    return gpt_train_step(state, batch, model_key, config=config)


@functools.partial(jax.jit, static_argnames="config")
def validate(state: TrainState, bank: CodeBank, step: Int[Array, ""], *, config: TrainGptConfig) -> Metrics:
    """Returns loss and accuracy on a batch of held-out motions, with clean inputs."""
    batch = make_batch(batch_at(bank, "validation", step, config=config), None, config=config)
    return gpt_metrics(state.params, batch, None, config=config)


def prepare(config: TrainGptConfig, resume: bool) -> Setup:
    """Returns the setup of a training.

    Raises:
        UserError: Data, tokenizer and GPT do not fit.
    """
    return prepare_generator(config, GeneratorSteps(init_gpt_state, update, validate), resume=resume)


TRAINER = Trainer(
    config=TrainGptConfig,
    prepare=prepare,
    resolve=resolve_generator,
    next_command='t2m generate "a person walks forward" --model {run}',
)
"""The entry point `gpt`."""
