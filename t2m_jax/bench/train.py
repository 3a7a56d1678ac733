"""Speed of training: one update of a tokenizer or of a generator, on random data of the right shapes."""

import dataclasses
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import numpy as np

from t2m_jax.bench.flops import count_flops
from t2m_jax.bench.record import BenchResult, Figure, Peaks
from t2m_jax.bench.timing import compile_program, program_figures, share, time_calls
from t2m_jax.checkpoints.bundle import bundle_path, load_bundle_config
from t2m_jax.data.banks.codes import CodeBank
from t2m_jax.data.banks.motions import MotionBank
from t2m_jax.models.caption_encoder import CaptionEncoderConfig
from t2m_jax.models.motion_gpt import MotionGptConfig
from t2m_jax.models.rows import Precision
from t2m_jax.models.vqvae import VqVaeConfig
from t2m_jax.text.bpe import CaptionTokens
from t2m_jax.train.config import LoopConfig, ShardingConfig
from t2m_jax.train.gpt import TrainGptConfig, init_gpt_state
from t2m_jax.train.gpt import update as gpt_update
from t2m_jax.train.hifigpt import TrainHiFiGptConfig, init_hifigpt_state
from t2m_jax.train.hifigpt import update as hifigpt_update
from t2m_jax.train.program import Devices, Update
from t2m_jax.train.vqvae import init_vqvae_state
from t2m_jax.train.vqvae import update as vqvae_update
from t2m_jax.train.vqvae_config import TrainRvqVaeConfig, TrainVqVaeConfig

Kind = Literal["vqvae", "gpt", "rvqvae", "hifigpt"]
"""What is trained."""
TrainConfig = TrainVqVaeConfig | TrainGptConfig | TrainHiFiGptConfig
Size = Literal["full", "demo"]
"""Sizes of the published models for HumanML3D, or of small ones like the packaged model."""
BATCHES: dict[tuple[str, str], int] = {
    ("vqvae", "full"): 256,
    ("gpt", "full"): 128,
    ("rvqvae", "full"): 256,
    ("hifigpt", "full"): 128,
    ("vqvae", "demo"): 96,
    ("gpt", "demo"): 64,
    ("rvqvae", "demo"): 96,
    ("hifigpt", "demo"): 64,
}
"""Batch of each recipe."""
CPU_BATCHES = BATCHES | {("gpt", "full"): 16, ("hifigpt", "full"): 16}
"""Default batches on a CPU, where an update of the full GPT with its own batch needs 21 GB."""
TOKENIZERS = {"gpt": TrainVqVaeConfig, "hifigpt": TrainRvqVaeConfig}
"""Whose codes a generator learns."""
RECIPE_STEPS = 300_000
"""Updates of each published recipe."""
CLIP_FRAMES = 200
"""Frames of a random clip, about the longest in HumanML3D."""


class Options(NamedTuple):
    """How an update is computed. `batch` is None for the default of the device."""

    batch: int | None = None
    precision: Precision = "float32"
    steps_per_call: int = 1
    remat: bool = False
    """Of a generator."""
    num_parts: int = 1
    """Of a generator."""


class Sizes(NamedTuple):
    """The parts of a model."""

    tokenizer: Any
    generator: Any
    text_encoder: CaptionEncoderConfig


def demo_sizes(kind: Kind) -> Sizes:
    """Returns the sizes of the packaged model, or those of `configs/t2m-gpt`, which are about as large."""
    packaged = load_bundle_config(bundle_path("demo"))
    if kind in ("rvqvae", "hifigpt"):
        return Sizes(packaged.tokenizer, packaged.generator, packaged.text_encoder)
    generator = MotionGptConfig(embed_dim=256, text_dim=256, num_layers=4, num_heads=8, block_size=41)
    return Sizes(VqVaeConfig(width=192, code_dim=128), generator, packaged.text_encoder)


def make_training(kind: Kind, size: Size, options: Options, *, devices: int = 1) -> TrainConfig:
    """Returns the config of a training at a size.

    Raises:
        ValueError: An option does not fit the batch.
    """
    # On a CPU a full generator would need more memory than most machines have.
    batches = CPU_BATCHES if jax.default_backend() == "cpu" else BATCHES
    batch = batches[kind, size] if options.batch is None else options.batch
    shared: dict[str, Any] = {
        "loop": LoopConfig(batch_size=batch, steps_per_call=options.steps_per_call),
        "sharding": ShardingConfig(devices=devices),
        "precision": options.precision,
    }
    if kind in ("vqvae", "rvqvae"):
        tokenizer = TrainVqVaeConfig if kind == "vqvae" else TrainRvqVaeConfig
        return tokenizer(**shared if size == "full" else shared | {"model": demo_sizes(kind).tokenizer})
    generator: type[TrainGptConfig | TrainHiFiGptConfig] = TrainGptConfig if kind == "gpt" else TrainHiFiGptConfig
    # Tokenizers do not have these options.
    shared |= {"remat": options.remat, "num_parts": options.num_parts}
    if size == "full":
        return generator(text_encoder="clip", **shared)
    sizes = demo_sizes(kind)
    return generator(model=sizes.generator, caption_encoder=sizes.text_encoder, **shared)


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
    captions: Any = generator.standard_normal((count, model.text_dim), np.float32)
    if config.text_encoder == "caption_encoder":
        sizes = config.caption_encoder
        tokens = generator.integers(1, sizes.vocabulary_size, (count, sizes.max_length), np.int32)
        captions = CaptionTokens(tokens, np.ones(tokens.shape, bool))
    lengths = np.full((count, 1), model.max_codes, np.int32)
    return CodeBank(codes, lengths, captions, np.arange(count, dtype=np.int32), np.ones(count, np.int32))


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
    frames = batch * config.model.max_codes * TOKENIZERS[config.kind]().model.downsample
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
    state = jax.eval_shape(lambda key: work.init(config, key), jax.random.key(0))
    return count_flops(lambda state, data: work.update(state, data, config=config), state, work.data)


def benchmark_training(config: TrainConfig, *, size: str, peaks: Peaks, repeats: int = 3) -> BenchResult:
    """Returns the speed of the updates of a training.

    Args:
        config: The training; its folders are not used.
        size: Name of its sizes, for the row.
        peaks: Of `config.sharding.devices` devices.
        repeats: Calls that are timed, each of `config.loop.steps_per_call` updates.

    Raises:
        UserError: There are not so many devices, or they do not divide the batch.
    """
    devices = Devices(config.sharding, batch_size=config.loop.batch_size)
    work = make_work(config)
    count = config.loop.steps_per_call
    update = Update(work.update, config=config)
    state = devices.put_state(work.init(config, jax.random.key(0)))
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

    timing = time_calls(call, repeats=repeats)
    rate = count / timing.median
    flops = update_flops(config)
    peak = peaks.bfloat16 if config.precision == "bfloat16" else peaks.float32
    figures = [
        Figure(name="updates", value=rate, unit="1/s", better="more", spread=timing.spread),
        Figure(name="frames", value=rate * work.frames, unit="1/s"),
        *program_figures(program),
        Figure(name="work", value=flops / 1e12, unit="TFLOP/update"),
        share("product", rate * flops, peak),
        Figure(name="first loss", value=float(np.asarray(losses[0])[0])),
    ]
    if size == "full" and config.loop.batch_size == BATCHES[config.kind, "full"]:
        figures.append(Figure(name=f"{RECIPE_STEPS:,} updates", value=RECIPE_STEPS / rate / 3600, unit="h"))
    name = _training_name(config, work.shape, size, devices.mesh.size)
    return BenchResult(benchmark="train", name=name, figures=tuple(figures))


def _training_name(config: TrainConfig, shape: str, size: str, num_devices: int) -> str:
    """Returns what was run, with all options that are not the defaults."""
    options = [f"{config.loop.steps_per_call} updates per call"] if config.loop.steps_per_call > 1 else []
    if not isinstance(config, TrainVqVaeConfig):
        options += ["remat"] if config.remat else []
        options += [f"{config.num_parts} parts"] if config.num_parts > 1 else []
    options += [f"{num_devices} devices"] if num_devices > 1 else []
    return ", ".join([f"{config.kind} {size} {shape} {config.precision}", *options])
