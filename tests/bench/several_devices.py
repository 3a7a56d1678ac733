"""Measures a tiny model on one and on two virtual devices: `python -m tests.bench.several_devices MODEL FOLDER`."""

import functools
import sys
from pathlib import Path

from t2m_jax.bench import probes, train
from t2m_jax.cli.main import main
from t2m_jax.train import LoopConfig, TrainVqVaeConfig
from t2m_jax.train.config import ShardingConfig
from tests import tiny


def tiny_training(kind, size, options, *, devices):
    sharding, loop = ShardingConfig(devices=devices), LoopConfig(batch_size=4)
    return TrainVqVaeConfig(model=tiny.VQVAE, window=32, sharding=sharding, loop=loop)


if __name__ == "__main__":
    model, folder = sys.argv[1], Path(sys.argv[2])
    probes.measure_peaks = functools.partial(probes.measure_peaks, product_sizes=(16,), array_sizes=(1024,))
    train.make_training = tiny_training
    commands = {
        "train": ["--kind", "vqvae"],
        "sample": ["--model", model, "--batch", "2", "--codes", "2"],
        "data": ["--batch", "4"],
    }
    for name, options in commands.items():
        options = [*options, "--devices", "1", "2", "--repeats", "1", "--json", f"{folder / name}.json"]
        assert main(["bench", name, *options]) == 0
    # The next command wants more devices than this process was started with.
    assert main(["bench", "data", "--devices", "4"]) == 2
