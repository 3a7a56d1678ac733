"""`t2m train` in two processes of four devices: as users start it, killed, and resumed in other ways."""

import csv
import dataclasses
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from t2m_jax.config import save_config
from t2m_jax.data import write_synthetic_dataset
from t2m_jax.train import LoopConfig
from t2m_jax.train.config import ShardingConfig
from tests import tiny
from tests.devices.test_many_devices import free_port

NUM_STEPS, HEARTBEAT = 60, 10
LOOP = LoopConfig(num_steps=NUM_STEPS, batch_size=8, seed=5, log_every=1, checkpoint_every=5, validate_every=20)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hosts")
    write_synthetic_dataset(folder / "data", num_clips=24, seed=0)
    config = tiny.vqvae_training(folder / "data", folder / "two", loop=LOOP)
    save_config(folder / "vqvae.yaml", dataclasses.replace(config, sharding=ShardingConfig(optimizer="sharded")))
    return folder


def start(folder, *options, devices):
    command = [sys.executable, "-m", "t2m_jax", "train", "vqvae", f"{folder / 'vqvae.yaml'}", *map(str, options)]
    environment = os.environ | {"JAX_NUM_CPU_DEVICES": f"{devices}", "T2M_JAX_NO_COMPILATION_CACHE": "1"}
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def start_pair(folder, *options, devices=4):
    place = ("--coordinator", f"127.0.0.1:{free_port()}", "--num-processes", 2, "--heartbeat", HEARTBEAT)
    return [start(folder, *place, "--process-id", number, *options, devices=devices) for number in (0, 1)]


def finish(*processes):
    try:
        return [(*process.communicate(timeout=300), process.returncode) for process in processes]
    finally:
        for process in processes:
            process.kill()


def losses(run):
    with (run / "train.csv").open(encoding="utf-8") as file:
        return [float(row["loss"]) for row in csv.DictReader(file)]


@pytest.mark.release
def test_two_processes_are_killed_and_go_on_as_two_and_as_one(folder):
    pair, run = start_pair(folder), folder / "two"
    end = time.monotonic() + 240
    while not (run / "checkpoints" / "10").exists():
        assert time.monotonic() < end and all(process.poll() is None for process in pair)
        time.sleep(0.05)
    killed = time.monotonic()
    pair[1].send_signal(signal.SIGKILL)
    assert finish(*pair)[0][2] != 0
    assert time.monotonic() - killed < 3 * HEARTBEAT + 10
    for _, errors, status in finish(*start_pair(folder, "--resume", "--loop.num_steps", 40)):
        assert status == 0, errors[-3000:]
    assert len(losses(run)) == 40
    ((_, errors, status),) = finish(start(folder, "--resume", "--sharding.devices", 1, devices=2))
    assert status == 0, errors[-3000:]
    ((_, errors, status),) = finish(start(folder, "--run", folder / "one", devices=1))
    assert status == 0, errors[-3000:]
    assert len(losses(run)) == NUM_STEPS
    # The bound is for 20 updates; the difference grows with the updates.
    np.testing.assert_allclose(losses(run)[:20], losses(folder / "one")[:20], rtol=1e-5)
    np.testing.assert_allclose(losses(run), losses(folder / "one"), rtol=1e-3)
    assert json.loads((run / "training_data.json").read_text(encoding="utf-8"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("process", "number"),
    [pytest.param(0, signal.SIGTERM, marks=pytest.mark.release), (1, signal.SIGUSR1)],
)
def test_a_signal_to_one_process_ends_both_after_the_same_update(folder, process, number):
    run = folder / f"stopped-{number}"
    options = ("--run", run, "--loop.num_steps", 10_000, "--loop.checkpoint_every", 0, "--loop.validate_every", 0)
    # The processes agree on the update, whatever the devices of each and the model are; small ones take less time.
    pair = start_pair(folder, *options, "--model.num_stages", 1, "--window", 16, devices=2)
    end = time.monotonic() + 240
    while not (run / "train.csv").exists() or len(losses(run)) < 10:
        assert time.monotonic() < end and all(process.poll() is None for process in pair)
        time.sleep(0.05)
    pair[process].send_signal(number)
    for _, errors, status in finish(*pair):
        assert status == 128 + signal.SIGTERM, errors[-3000:]
    (kept,) = (run / "checkpoints").iterdir()
    assert int(kept.name) == len(losses(run)) >= 10


@pytest.mark.slow
@pytest.mark.release
def test_only_process_0_prints_the_result(folder):
    one, other = finish(*start_pair(folder, "--run", folder / "printed", "--loop.num_steps", 5))
    assert one[2] == other[2] == 0, one[1][-2000:]
    assert f"{folder / 'printed'}" in one[0]
    assert f"{folder / 'printed'}" not in other[0]
