"""SIGKILL at awkward moments: what is on disk always loads, and going on ends where an unkilled run ends."""

import dataclasses
import os
import random
import shutil
import signal
import subprocess
import sys
import time

import pytest

from t2m_jax.checkpoints import Checkpoints, load_tokenizer
from t2m_jax.checkpoints.run import is_run
from t2m_jax.config import save_config
from t2m_jax.train import train
from tests.tiny import LOOP, vqvae_training
from tests.train.conftest import assert_same_checkpoint

NUM_STEPS = 400
PATIENCE = 180.0
"""Seconds until a training that shows no checkpoint counts as hung."""


@pytest.fixture
def training(runs, tmp_path):
    """Returns a config on disk whose every step is checkpointed, and its run folder."""
    loop = dataclasses.replace(LOOP, num_steps=NUM_STEPS, checkpoint_every=1, validate_every=0, log_every=1)
    save_config(tmp_path / "vqvae.yaml", vqvae_training(runs.data, tmp_path / "run", loop=loop))
    return tmp_path / "vqvae.yaml", tmp_path / "run"


def start(config, tmp_path, *options):
    """Starts the real program; programs it compiles are kept for the next start."""
    environment = os.environ | {
        "JAX_COMPILATION_CACHE_DIR": f"{tmp_path / 'cache'}",
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    command = [sys.executable, "-m", "t2m_jax.cli", "train", "vqvae", f"{config}", *options]
    return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def names(run):
    """Returns what lies in the folder of checkpoints: finished ones by number, and one being written."""
    folder = run / "checkpoints"
    return {path.name for path in folder.iterdir()} if folder.is_dir() else set()


def wait_for(process, condition):
    """Waits until something is on disk."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < end, "training shows no sign of life"
        time.sleep(0.002)


def kill(process):
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL


def newest(run, tmp_path):
    """Returns the step of the newest checkpoint of a copy (opening one tidies up), having loaded it."""
    copy = tmp_path / "copy"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(run, copy)
    with Checkpoints(copy) as checkpoints:
        step = checkpoints.latest_step
    if step is not None:
        load_tokenizer(copy)
    return step or 0


def test_a_killed_training_goes_on_as_if_nothing_had_happened(training, runs, tmp_path):
    config, run = training
    draws = random.Random(0)
    reached = 0

    def partial():
        return any(not name.isdigit() for name in names(run) - before)

    def finished():
        return any(name.isdigit() and int(name) > reached + 2 for name in names(run) - before)

    for moment in (partial, finished, partial):
        before = names(run)
        process = start(config, tmp_path, *(["--resume"] if is_run(run) else []))
        wait_for(process, moment)
        time.sleep(draws.uniform(0.0, 0.02))
        kill(process)
        if is_run(run):
            step = newest(run, tmp_path)
            assert step >= reached, "a kill lost a checkpoint that was complete"
            reached = step
    assert 2 < reached < NUM_STEPS, "training was not killed on its way"

    last = ["--loop.num-steps", f"{reached + 5}"]
    process = start(config, tmp_path, "--resume", *last)
    errors = process.communicate(timeout=PATIENCE)[1]
    assert process.returncode == 0, errors
    loop = dataclasses.replace(LOOP, num_steps=reached + 5, validate_every=0)
    train(vqvae_training(runs.data, tmp_path / "unkilled", loop=loop))
    assert_same_checkpoint(run, tmp_path / "unkilled")
    rows = (run / "train.csv").read_text(encoding="utf-8").splitlines()
    assert [int(row.split(",")[0]) for row in rows[1:]] == list(range(1, reached + 6))
