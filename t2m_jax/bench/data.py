"""Speed of the data: batches of windows from a bank on the devices, and opening a data set."""

import functools
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

from t2m_jax.bench.probes import on_devices
from t2m_jax.bench.record import BenchResult, Figure, Peaks
from t2m_jax.bench.timing import compile_program, share, speed, time_calls
from t2m_jax.bench.train import random_motions
from t2m_jax.data.banks.motions import batch_at
from t2m_jax.data.folder import open_dataset
from t2m_jax.keys import new_key
from t2m_jax.train.config import LoopConfig, ShardingConfig
from t2m_jax.train.program import Devices
from t2m_jax.train.vqvae_config import TrainVqVaeConfig

BATCH = 256
"""Windows of a batch of the published VQ-VAE."""
WINDOW = 64
"""Frames of each."""


def benchmark_windows(*, peaks: Peaks) -> BenchResult:
    """Returns how many windows are cut in a second from a bank of random motion that each device has.

    Raises:
        UserError: There are not so many devices, or they do not divide the batch.
    """
    config = TrainVqVaeConfig(loop=LoopConfig(batch_size=BATCH), window=WINDOW)
    devices = Devices(ShardingConfig(devices=peaks.num_devices), batch_size=BATCH)
    arguments = (devices.put_data(random_motions(config)), new_key(0), np.int32(0))
    draw = jax.jit(functools.partial(batch_at, batch_size=BATCH, window=WINDOW))
    with jax.set_mesh(devices.mesh):
        program = compile_program(lambda: draw.lower(*arguments))
    timing = time_calls(lambda: program.compiled(*arguments))
    moved = 2 * BATCH * WINDOW * config.model.feature_dim * 4  # frames are read from the bank and written
    figures = (speed(BATCH, timing), *program.figures, share("memory", moved / timing.median, peaks.memory))
    name = f"windows, {BATCH}x{WINDOW}{on_devices(peaks.num_devices)}"
    return BenchResult(benchmark="data", name=name, figures=figures)


def benchmark_opening(folder: str | Path) -> BenchResult:
    """Returns how many training clips of a data set are opened in a second; its cache is made before that.

    Raises:
        UserError: The folder is not a data set.
    """

    def open_clips() -> Any:
        return open_dataset(folder).clips("train")

    # The first opening also makes the cache, if there is none.
    start = time.perf_counter()
    count = len(open_clips())
    first = Figure(name="first opening", value=time.perf_counter() - start, unit="s")
    figures = (speed(count, time_calls(open_clips)), first)
    return BenchResult(benchmark="data", name=f"clips of {Path(folder).name}, {count}", figures=figures)
