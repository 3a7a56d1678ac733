"""Training of both parts: what differs from the other systems, and nothing else."""

import dataclasses
import functools
from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp
import optax

from lookup_bigram.models import Bigram, BigramConfig, Lookup, LookupConfig
from t2m_jax.checkpoints import TrainedTokenizer, load_tokenizer
from t2m_jax.checkpoints.tokenizer import save_tokenizer_parts
from t2m_jax.data import open_dataset
from t2m_jax.data.banks.codes import code_batch_at
from t2m_jax.data.banks.motions import batch_at, make_bank
from t2m_jax.data.banks.order import row_keys
from t2m_jax.devices import own_rows
from t2m_jax.evaluation.sources import Reconstruction
from t2m_jax.masks import masked_mean
from t2m_jax.train import ExperimentConfig, LoopConfig, OptimizerConfig, Setup, Trainer
from t2m_jax.train.config import EvaluationConfig, compiled_config
from t2m_jax.train.experiment import Evaluation
from t2m_jax.train.generator import (
    GeneratorSteps,
    TrainGeneratorConfig,
    embed_captions,
    init_caption_encoder,
    prepare_generator,
    resolve_generator,
)
from t2m_jax.train.optimizer import descend, first_state
from t2m_jax.train.program import Update
from t2m_jax.train.streams import stream_key


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainLookupConfig(ExperimentConfig):
    """Training of the tokenizer."""

    kind: ClassVar[str] = "lookup"

    run: Path = Path("runs/lookup")
    """Run directory to write."""
    model: LookupConfig = LookupConfig()
    """Sizes."""
    optimizer: OptimizerConfig = OptimizerConfig(learning_rate=1e-2)
    """Optimizer."""
    evaluation: EvaluationConfig = EvaluationConfig()
    """Evaluation of reconstructions."""


def update_lookup(state, bank, *, config):
    key = stream_key(config.loop.seed, "data")
    windows = batch_at(bank, key, state.step, batch_size=config.loop.batch_size, window=32)

    def measure(params):
        reconstruction, _ = Lookup(config.model).apply({"params": params}, windows.motion, windows.mask, train=True)
        loss = masked_mean((reconstruction - windows.motion) ** 2, windows.mask[:, :, None])
        return {"loss": loss}, {}

    return descend(state, measure, config.optimizer)


def init_lookup(config):
    module = Lookup(config.model)
    motion = jnp.zeros((1, config.model.downsample, config.model.feature_dim))
    params = module.init(stream_key(config.loop.seed, "init"), motion, train=False)["params"]
    return first_state(params, config.optimizer)


def prepare_lookup(config, resume):
    dataset = open_dataset(config.data)
    clips = dataset.clips("train", min_frames=config.model.downsample, fraction=config.data_fraction)

    def source(state, clips):
        return Reconstruction(TrainedTokenizer(config.model, {"params": state.params}, dataset.normalizer))

    return Setup(
        dataset=dataset,
        clips=clips,
        data=make_bank(clips, dataset.normalizer),
        init=lambda: init_lookup(config),
        update=Update(update_lookup, config=compiled_config(config)),
        optimizer=config.optimizer,
        frames_per_step=config.loop.batch_size * 32,
        weights=lambda state: {"params": state.params},
        write_parts=lambda run: save_tokenizer_parts(run, config.model, dataset.normalizer),
        start_from=lambda path: load_tokenizer(path).variables,
        evaluation=Evaluation(config.evaluation, config.model.downsample, source),
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainBigramConfig(TrainGeneratorConfig):
    """Training of the prior."""

    kind: ClassVar[str] = "bigram"

    run: Path = Path("runs/bigram")
    """Run directory to write."""
    model: BigramConfig = BigramConfig()
    """Sizes."""
    optimizer: OptimizerConfig = OptimizerConfig(learning_rate=1e-2)
    """Optimizer."""
    loop: LoopConfig = LoopConfig(num_steps=10, batch_size=4)
    """Length."""


def init_bigram(config, key):
    bigram_key, caption_key = jax.random.split(key)
    rows, text = jnp.zeros((1, 1, 2), jnp.int32), jnp.zeros((1, config.model.text_dim))
    params = {"bigram": Bigram(config.model).init(bigram_key, rows, text, train=False)["params"]}
    return first_state(params | init_caption_encoder(config, caption_key), config.optimizer)


def bigram_metrics(params, batch, keys, config):
    text = embed_captions(params, batch.captions, keys, config=config)
    logits, stops = Bigram(config.model).apply({"params": params["bigram"]}, batch.codes, text, train=True)
    position = jnp.arange(batch.codes.shape[1])[None]
    mask, is_last = position < batch.code_lengths[:, None], position == batch.code_lengths[:, None] - 1
    errors = optax.losses.softmax_cross_entropy_with_integer_labels(logits, batch.codes).mean(-1)
    errors = errors + optax.losses.sigmoid_binary_cross_entropy(stops, is_last.astype(jnp.float32))
    return {"loss": masked_mean(errors, mask)}


def bigram_batch(bank, stream, step, config):
    key, size = stream_key(config.loop.seed, stream), config.loop.batch_size
    return code_batch_at(bank, key, step, batch_size=size, max_codes=config.model.max_codes)


def update_bigram(state, bank, *, config):
    batch = bigram_batch(bank, "data", state.step, config)
    keys = row_keys(stream_key(config.loop.seed, "model"), state.step, own_rows(config.loop.batch_size))
    return descend(state, lambda params: (bigram_metrics(params, batch, keys, config), {}), config.optimizer)


@functools.partial(jax.jit, static_argnames="config")
def validate_bigram(state, bank, step, *, config):
    return bigram_metrics(state.params, bigram_batch(bank, "validation", step, config), None, config)


LOOKUP = Trainer(config=TrainLookupConfig, prepare=prepare_lookup)
BIGRAM = Trainer(
    config=TrainBigramConfig,
    prepare=lambda config, resume: prepare_generator(
        config, GeneratorSteps(init_bigram, update_bigram, validate_bigram), resume=resume
    ),
    resolve=resolve_generator,
)
