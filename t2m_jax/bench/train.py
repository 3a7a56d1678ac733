"""Speed of training: one update of a tokenizer or of a generator, on random data of the right shapes."""

import dataclasses
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import numpy as np

from t2m_jax.bench.probes import on_devices
from t2m_jax.bench.record import BenchResult, Figure, Peaks
from t2m_jax.bench.sample import TOKENIZERS, published_config
from t2m_jax.bench.timing import compile_program, count_flops, share, time_calls
from t2m_jax.config import load_config
from t2m_jax.data.banks.codes import Captions, CodeBank
from t2m_jax.data.banks.motions import MotionBank
from t2m_jax.keys import new_key
from t2m_jax.models.caption_encoder import CaptionEncoderConfig
from t2m_jax.models.rows import Precision
from t2m_jax.text.bpe import CaptionTokens
from t2m_jax.text.caption_states import StateTable
from t2m_jax.train.config import LoopConfig, ShardingConfig
from t2m_jax.train.experiment import find_trainer
from t2m_jax.train.gpt import TrainGptConfig, init_gpt_state
from t2m_jax.train.gpt import update as gpt_update
from t2m_jax.train.hifigpt import TrainHiFiGptConfig, init_hifigpt_state
from t2m_jax.train.hifigpt import update as hifigpt_update
from t2m_jax.train.program import Devices, Update
from t2m_jax.train.shipped import find_config
from t2m_jax.train.vqvae import init_vqvae_state
from t2m_jax.train.vqvae import update as vqvae_update
from t2m_jax.train.vqvae_config import TrainVqVaeConfig

TrainConfig = TrainVqVaeConfig | TrainGptConfig | TrainHiFiGptConfig
DEMO_CONFIGS = {"vqvae": "t2m-gpt/vqvae", "gpt": "t2m-gpt/gpt", "rvqvae": "demo/rvqvae", "hifigpt": "demo/hifigpt"}
"""The configs of small models: of T2M-GPT, and of the packaged model."""
CPU_BATCH = 16
"""Default batch of a full generator on a CPU, where an update with its own batch of 128 needs 21 GB."""
RECIPE_STEPS = 300_000
"""Updates of each published recipe."""
CLIP_FRAMES = 200
"""Frames of a random clip, about the longest in HumanML3D."""


def full_training(kind: str) -> TrainConfig:
    """Returns the config of a published training; its sizes are the defaults."""
    return find_trainer(kind).config(**{"text_encoder": "clip"} if kind in TOKENIZERS else {})


def make_training(
    kind: str,
    size: Literal["full", "demo"] = "full",
    *,
    batch: int | None = None,
    precision: Precision = "float32",
    devices: int = 1,
) -> TrainConfig:
    """Returns the config of a training: of a published model, or with `demo` of a small one."""
    config = full_training(kind)
    if size == "demo":
        config = load_config(find_config(kind, DEMO_CONFIGS[kind]), type(config))
    elif kind in TOKENIZERS and jax.default_backend() == "cpu":
        batch = batch or CPU_BATCH
    loop = LoopConfig(batch_size=batch or config.loop.batch_size)
    return dataclasses.replace(config, precision=precision, loop=loop, sharding=ShardingConfig(devices=devices))


def random_motions(config: TrainVqVaeConfig) -> MotionBank:
    """Returns a bank of normal random clips, two batches of them."""
    count = 2 * config.loop.batch_size
    width = config.model.feature_dim
    # Normalized features have about this distribution.
    frames = np.random.default_rng(0).standard_normal((count * CLIP_FRAMES, width), np.float32)
    lengths = np.full(count, CLIP_FRAMES, np.int32)
    starts = np.arange(count, dtype=np.int32) * CLIP_FRAMES
    return MotionBank(frames, starts, lengths, np.zeros(width, np.float32), np.ones(width, np.float32))


def random_codes(config: TrainGptConfig | TrainHiFiGptConfig) -> CodeBank:
    """Returns a bank of random codes of the greatest length, two batches of them, each with one caption."""
    count = 2 * config.loop.batch_size
    model = config.model
    generator = np.random.default_rng(0)
    codes = generator.integers(0, model.num_codes, (count, 1, model.max_codes, model.num_quantizers), np.int32)
    lengths = np.full((count, 1), model.max_codes, np.int32)
    numbers = np.arange(count, dtype=np.int32)
    return CodeBank(codes, lengths, random_captions(config, generator), numbers, np.ones(count, np.int32))


def random_captions(config: TrainGptConfig | TrainHiFiGptConfig, generator: np.random.Generator) -> Captions:
    """Returns random captions of the greatest length, one for each of two batches of motions."""
    count = 2 * config.loop.batch_size
    network = config.text_network
    if network is None:
        embeddings: Any = generator.standard_normal((count, config.model.text_dim), np.float32)
        return embeddings
    length = network.max_length
    if isinstance(network, CaptionEncoderConfig):
        tokens = generator.integers(1, network.vocabulary_size, (count, length), np.int32)
        return CaptionTokens(tokens, np.ones(tokens.shape, bool))
    states = generator.standard_normal((count * length, network.state_dim), np.float32).astype(np.float16)
    numbers = np.arange(count, dtype=np.int32)
    return StateTable(
        states, numbers * length, np.full(count, length, np.int32), numbers, np.arange(length, dtype=np.int32)
    )


class Work(NamedTuple):
    """What a training computes."""

    init: Callable[..., Any]
    update: Callable[..., tuple[Any, Any]]
    data: Any
    frames: int
    """Frames of a batch."""
    shape: str
    """Batch and length of a sequence."""


def make_work(config: TrainConfig) -> Work:
    """Returns what a training computes, with random data."""
    batch = config.loop.batch_size
    if isinstance(config, TrainVqVaeConfig):
        frames = batch * config.window
        return Work(init_vqvae_state, vqvae_update, random_motions(config), frames, f"{batch}x{config.window}")
    # Of a generator, a frame is one that its codes stand for.
    frames = batch * config.model.max_codes * published_config(TOKENIZERS[config.kind]).downsample
    if isinstance(config, TrainGptConfig):
        return Work(init_gpt_state, gpt_update, random_codes(config), frames, f"{batch}x{config.model.block_size}")
    shape = f"{batch}x{config.model.max_codes}x{config.model.num_quantizers}"
    return Work(init_hifigpt_state, hifigpt_update, random_codes(config), frames, shape)


def update_flops(config: TrainConfig) -> float:
    """Returns the operations of the products of one update, without those that `remat` repeats."""
    # What `remat` computes twice is no progress, so it must not count as reached speed.
    if not isinstance(config, TrainVqVaeConfig):
        config = dataclasses.replace(config, remat=False, num_parts=1)
    work = make_work(config)
    state = jax.eval_shape(lambda key: work.init(config, key), new_key(0))
    return count_flops(lambda state, data: work.update(state, data, config=config), state, work.data)


def benchmark_training(config: TrainConfig, *, size: str, peaks: Peaks) -> BenchResult:
    """Returns the speed of the updates of a training.

    Args:
        config: The training; its folders are not used.
        size: Name of its sizes, for the row.
        peaks: Of `config.sharding.devices` devices.

    Raises:
        UserError: There are not so many devices, or they do not divide the batch.
    """
    devices = Devices(config.sharding, batch_size=config.loop.batch_size)
    work = make_work(config)
    count = config.loop.steps_per_call
    update = Update(work.update, config=config)
    state = devices.put_state(work.init(config, new_key(0)))
    data = devices.put_data(work.data)
    program = compile_program(lambda: devices.lower(update, state, data, size=count))
    # The state is donated to each call, so the next one needs the new state. The first loss tells whether several
    # devices compute what one does.
    losses: list[Any] = []

    def call() -> Any:
        nonlocal state
        state, metrics = devices.run(update, state, data, count, size=count)
        losses.append(metrics["loss"])
        return state

    timing = time_calls(call)
    rate = count / timing.median
    flops = update_flops(config)
    peak = peaks.bfloat16 if config.precision == "bfloat16" else peaks.float32
    figures = [
        Figure(name="updates", value=rate, unit="1/s", better="more", spread=timing.spread),
        Figure(name="frames", value=rate * work.frames, unit="1/s"),
        *program.figures,
        Figure(name="work", value=flops / 1e12, unit="TFLOP/update"),
        share("product", rate * flops, peak),
        Figure(name="first loss", value=float(np.asarray(losses[0])[0])),
    ]
    if size == "full" and config.loop.batch_size == full_training(config.kind).loop.batch_size:
        figures.append(Figure(name=f"{RECIPE_STEPS:,} updates", value=RECIPE_STEPS / rate / 3600, unit="h"))
    name = f"{config.kind} {size} {work.shape} {config.precision}{on_devices(devices.mesh.size)}"
    return BenchResult(benchmark="train", name=name, figures=tuple(figures))
