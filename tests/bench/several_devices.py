"""Measures a tiny model on one and on two virtual devices: `python -m tests.bench.several_devices MODEL FOLDER`."""

import sys
from pathlib import Path

from t2m_jax.bench import data, probes, sample, timing, train
from t2m_jax.cli.main import main
from t2m_jax.train import LoopConfig, TrainVqVaeConfig
from t2m_jax.train.config import ShardingConfig
from tests import tiny


def tiny_training(kind, size, *, devices, **_):
    sharding, loop = ShardingConfig(devices=devices), LoopConfig(batch_size=4)
    return TrainVqVaeConfig(model=tiny.VQVAE, window=32, sharding=sharding, loop=loop)


if __name__ == "__main__":
    model, folder = sys.argv[1], Path(sys.argv[2])
    probes.PRODUCT_SIZES, probes.ARRAY_SIZES, timing.REPEATS = (16,), (1024,), 1
    data.BATCH, sample.NUM_CODES = 4, 2
    train.make_training = tiny_training
    commands = {
        "train": ["--kind", "vqvae"],
        "sample": ["--model", model, "--batch", "2"],
        "data": [],
    }
    for name, options in commands.items():
        options = [*options, "--devices", "1", "2", "--json", f"{folder / name}.json"]
        assert main(["bench", name, *options]) == 0
    # The next command wants more devices than this process was started with.
    assert main(["bench", "data", "--devices", "4"]) == 2
