"""Training on one device, on eight, in two processes, under jit and pmap: the same run."""

import csv
import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from t2m_jax.checkpoints.evaluator import save_evaluator
from t2m_jax.data import write_synthetic_dataset
from t2m_jax.train import train
from tests import tiny
from tests.devices.worker import KINDS, NUM_UPDATES

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).parents[2]
TOLERANCE = 1e-5


@pytest.fixture(scope="module")
def data_folder(tmp_path_factory):
    """A folder with data."""
    folder = tmp_path_factory.mktemp("devices")
    write_synthetic_dataset(folder / "data", num_clips=24, seed=0)
    return folder


@pytest.fixture(scope="module")
def folder(data_folder):
    """Data, a tokenizer and an evaluator."""
    folder = data_folder
    train(tiny.vqvae_training(folder / "data", folder / "vqvae"))
    save_evaluator(folder / "evaluator", tiny.random_evaluator())
    return folder


def start(task, folder, **options):
    words = [f"{name}={value}" for name, value in options.items()]
    command = [sys.executable, "-m", "tests.devices.worker", task, f"{folder}", *words]
    environment = os.environ | {"T2M_JAX_NO_COMPILATION_CACHE": "1"}
    return subprocess.Popen(command, cwd=REPOSITORY, env=environment, stderr=subprocess.PIPE, text=True)


def finish(*processes, status=0):
    for process in processes:
        try:
            _, errors = process.communicate(timeout=400)
        finally:
            process.kill()
        assert process.returncode == status, errors[-3000:]


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def start_pair(folder, **options):
    """Starts two processes with four devices each."""
    port = free_port()
    return [start("memory", folder, name="pair", local=4, process=number, port=port, **options) for number in (0, 1)]


def read_runs(folder, name):
    """Returns what `train_in_memory` found, by way (with the name of the file), kind and metric."""
    with np.load(folder / f"{name}.npz") as file:
        return {(f"{name} {way}", kind, metric): file[key] for key in file for way, kind, metric in [key.split(" ")]}


@pytest.fixture(scope="module")
def trained(folder):
    """Returns what each way of training gave."""
    pair = start_pair(folder, ways="vqvae:jit,gpt:jit")
    finish(start("memory", folder, name="alone", ways="one,jit,vqvae:pmap,gpt:pmap"), *pair)
    return read_runs(folder, "alone") | read_runs(folder, "pair")


WAYS = [("alone jit", kind) for kind in KINDS]
WAYS += [(way, kind) for way in ("alone pmap", "pair jit") for kind in ("vqvae", "gpt")]


@pytest.mark.release
def test_every_way_gives_the_same_run(trained):
    for way, kind in WAYS:
        assert_same_run(trained, way, kind)


@pytest.mark.release
def test_every_way_gives_the_same_evaluator(folder, trained):
    ways = "movement:pmap,evaluator:pmap"
    finish(start("memory", folder, name="evaluators", ways=ways), *start_pair(folder, ways="evaluator:jit"))
    runs = trained | read_runs(folder, "pair") | read_runs(folder, "evaluators")
    for way, kind in (("evaluators pmap", "movement"), ("evaluators pmap", "evaluator"), ("pair jit", "evaluator")):
        assert_same_run(runs, way, kind)


@pytest.mark.release
def test_two_processes_under_pmap_and_a_sharded_state_give_the_same_run(folder, trained):
    finish(start("memory", folder, name="sharded", ways="vqvae:shares"), *start_pair(folder, ways="vqvae:pmap"))
    runs = trained | read_runs(folder, "pair") | read_runs(folder, "sharded")
    assert_same_run(runs, "pair pmap", "vqvae")
    assert_same_run(runs, "sharded shares", "vqvae")


def assert_same_run(trained, way, kind):
    reference = {metric: values for (name, of, metric), values in trained.items() if (name, of) == ("alone one", kind)}
    losses = reference["loss"]
    assert len(losses) == NUM_UPDATES
    assert len(set(losses.tolist())) > 15, "nothing was learned"
    np.testing.assert_allclose(trained[way, kind, "loss"], losses, rtol=TOLERANCE)
    for metric, values in reference.items():
        scale = np.abs(values).max()
        np.testing.assert_allclose(trained[way, kind, metric], values, atol=10 * TOLERANCE * scale, err_msg=metric)
    if kind.endswith("vqvae"):
        np.testing.assert_allclose(trained[way, kind, "codebook"], reference["codebook"], atol=TOLERANCE)
        # How often every code was chosen, in all updates: equal if every code is.
        np.testing.assert_allclose(trained[way, kind, "hits"], reference["hits"], atol=1e-5)


@pytest.mark.release
def test_the_second_system_gives_the_same_run(folder):
    train(tiny.rvqvae_training(folder / "data", folder / "rvqvae"))
    # Jit and pmap divide both stages in the same way, as the tests of the first system show.
    finish(start("memory", folder, name="alone", ways="rvqvae:one,rvqvae:jit,hifigpt:one,hifigpt:pmap"))
    runs = read_runs(folder, "alone")
    assert_same_run(runs, "alone jit", "rvqvae")
    assert_same_run(runs, "alone pmap", "hifigpt")


def test_batches_banks_and_optimizers_are_divided(data_folder):
    finish(start("cut", data_folder))


def losses(run):
    with (run / "train.csv").open(encoding="utf-8") as file:
        return [float(row["loss"]) for row in csv.DictReader(file)]


@pytest.mark.release
def test_a_run_that_is_killed_on_eight_devices_goes_on_with_two_and_one(folder):
    finish(start("die", folder, devices=8, at=11), status=9)
    assert len(losses(folder / "run")) == 11
    finish(start("resume", folder, devices=2, until=14))
    finish(start("resume", folder, devices=1, until=NUM_UPDATES))
    finish(start("memory", folder, name="reference", ways="vqvae:one"))
    with np.load(folder / "reference.npz") as file:
        np.testing.assert_allclose(losses(folder / "run"), file["one vqvae loss"], rtol=TOLERANCE)


def test_motions_are_the_same_on_one_and_on_eight_devices(tmp_path):
    finish(start("generate", tmp_path, local=1), start("generate", tmp_path, local=8))
    with np.load(tmp_path / "1.npz") as one, np.load(tmp_path / "8.npz") as eight:
        assert len(one.files) == len(eight.files) > 16
        for name in one.files:
            np.testing.assert_array_equal(one[name], eight[name], err_msg=name)
