"""Speed of the data: batches of windows from a bank on the devices, and opening a data set."""

import functools
import time
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np

from t2m_jax.bench.record import BenchResult, Figure, Peaks
from t2m_jax.bench.timing import compile_program, program_figures, share, time_calls
from t2m_jax.bench.train import random_motions
from t2m_jax.data.banks.motions import batch_at
from t2m_jax.data.folder import open_dataset
from t2m_jax.train.config import LoopConfig, ShardingConfig
from t2m_jax.train.program import Devices
from t2m_jax.train.vqvae_config import TrainVqVaeConfig

BATCH = 256
"""Windows of a batch of the published VQ-VAE."""
WINDOW = 64
"""Frames of each."""


def benchmark_windows(
    *,
    num_devices: int,
    peaks: Peaks,
    bank: Literal["replicated", "sharded"] = "replicated",
    batch: int = BATCH,
    repeats: int = 3,
) -> BenchResult:
    """Returns how many windows are cut in a second from a bank of random motion.

    Args:
        num_devices: Number of devices, among which a batch is divided.
        peaks: Of these devices.
        bank: Whether each device has all of the motion or its share.
        batch: Windows of a batch.
        repeats: Calls that are timed, each of one batch.

    Raises:
        UserError: There are not so many devices, or they do not divide the batch.
    """
    config = TrainVqVaeConfig(loop=LoopConfig(batch_size=batch), window=WINDOW)
    devices = Devices(ShardingConfig(devices=num_devices, bank=bank), batch_size=batch)
    arguments = (devices.put_data(random_motions(config)), jax.random.key(0), np.int32(0))
    draw = jax.jit(functools.partial(batch_at, batch_size=batch, window=WINDOW))
    with jax.set_mesh(devices.mesh):
        program = compile_program(lambda: draw.lower(*arguments))
    timing = time_calls(lambda: program.compiled(*arguments), repeats=repeats)
    moved = 2 * batch * WINDOW * config.model.feature_dim * 4  # frames are read from the bank and written
    figures = (
        Figure(name="speed", value=batch / timing.median, unit="1/s", better="more", spread=timing.spread),
        *program_figures(program),
        share("memory", moved / timing.median, peaks.memory),
    )
    place = "" if num_devices == 1 else f", {num_devices} devices, bank {bank}"
    return BenchResult(benchmark="data", name=f"windows, {batch}x{WINDOW}{place}", figures=figures)


def benchmark_opening(folder: str | Path, *, repeats: int = 3) -> BenchResult:
    """Returns how many training clips of a data set are opened in a second; its cache is made before that.

    Raises:
        UserError: The folder is not a data set.
    """

    def open_clips() -> Any:
        return open_dataset(folder).clips("train")

    # The first opening also makes the cache, if there is none.
    start = time.perf_counter()
    count = len(open_clips())
    first = time.perf_counter() - start
    timing = time_calls(open_clips, repeats=repeats)
    figures = (
        Figure(name="speed", value=count / timing.median, unit="1/s", better="more", spread=timing.spread),
        Figure(name="first opening", value=first, unit="s"),
    )
    return BenchResult(benchmark="data", name=f"clips of {Path(folder).name}, {count}", figures=figures)
