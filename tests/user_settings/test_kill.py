"""Trainings that are killed (SIGKILL) while they write: their runs load, and resumed they end bit for bit as others.

The programs are started as users start them, with XLA's optimizations.
"""

import dataclasses
import random
import shutil
import signal
import subprocess
import sys
import time

import pytest

from t2m_jax.checkpoints import load_tokenizer
from t2m_jax.checkpoints.run import Checkpoints, is_run
from t2m_jax.config import save_config
from t2m_jax.data import write_synthetic_dataset
from t2m_jax.train import train
from tests.jit import SETTING
from tests.tiny import LOOP, gpt_training, vqvae_training
from tests.train.conftest import assert_same_checkpoint

NUM_STEPS = 400
PATIENCE = 180.0
"""Seconds until a training that shows no checkpoint counts as hung."""


@pytest.fixture(scope="module", autouse=True)
def settings_of_users(tmp_path_factory):
    """Lets programs start with users' settings; what one compiles is kept for those after it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JAX_COMPILATION_CACHE_DIR", f"{tmp_path_factory.mktemp('programs')}")
        patch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        patch.delenv(SETTING.upper())
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("killed") / "data"
    write_synthetic_dataset(folder, num_clips=20, seed=3)
    return folder


@pytest.fixture
def training(request, data, tmp_path):
    """Returns a config on disk whose every step is checkpointed."""
    loop = dataclasses.replace(LOOP, num_steps=NUM_STEPS, checkpoint_every=1, validate_every=0, log_every=1)
    if request.param == "vqvae":
        config = vqvae_training(data, tmp_path / "run", loop=loop)
    else:
        train(vqvae_training(data, tmp_path / "vqvae"))
        config = gpt_training(data, tmp_path / "vqvae", tmp_path / "run", loop=loop)
    save_config(tmp_path / f"{request.param}.yaml", config)
    return tmp_path / f"{request.param}.yaml"


def start(config, *options):
    """Starts the real program."""
    command = [sys.executable, "-m", "t2m_jax", "train", config.stem, f"{config}", *options]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def finish(config, *options):
    """Waits for the end of a training."""
    process = start(config, *options)
    errors = process.communicate(timeout=PATIENCE)[1]
    assert process.returncode == 0, errors


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
        step = checkpoints.newest_intact()[0]
    if step is not None:
        load_tokenizer(copy)
    return step or 0


@pytest.mark.slow
@pytest.mark.parametrize("training", ["vqvae", pytest.param("gpt", marks=pytest.mark.release)], indirect=True)
def test_a_killed_training_ends_as_one_that_was_not_killed(training, tmp_path):
    run, draws, reached = tmp_path / "run", random.Random(0), 0

    def partial():
        return any(not name.isdigit() for name in names(run) - before)

    def finished():
        return any(name.isdigit() and int(name) > reached + 2 for name in names(run) - before)

    for moment in (finished, partial):
        before = names(run)
        process = start(training, *(["--resume"] if is_run(run) else []))
        wait_for(process, moment)
        time.sleep(draws.uniform(0.0, 0.02))
        kill(process)
        if is_run(run):
            step = newest(run, tmp_path)
            assert step >= reached, "a kill lost a checkpoint that was complete"
            reached = step
    assert 2 < reached < NUM_STEPS, "training was not killed on its way"

    last = ["--loop.num-steps", f"{reached + 5}", "--loop.checkpoint_every", "0"]
    finish(training, "--resume", *last)
    finish(training, "--run", f"{tmp_path / 'unkilled'}", *last)
    assert_same_checkpoint(run, tmp_path / "unkilled")
    rows = (run / "train.csv").read_text(encoding="utf-8").splitlines()
    assert [int(row.split(",")[0]) for row in rows[1:]] == list(range(1, reached + 6))


@pytest.mark.slow
@pytest.mark.parametrize("training", ["vqvae"], indirect=True)
@pytest.mark.parametrize("name", ["SIGINT", pytest.param("SIGUSR1", marks=pytest.mark.release)])
def test_a_training_that_is_asked_to_stop_loses_no_update(training, tmp_path, name):
    run, number = tmp_path / "run", getattr(signal, name)
    process = start(training, "--loop.checkpoint_every", "0", "--loop.log_every", "1")
    wait_for(process, lambda: (run / "train.csv").is_file() and (run / "train.csv").read_text().count("\n") > 20)
    process.send_signal(number)
    errors = process.communicate(timeout=PATIENCE)[1]
    assert process.returncode == 128 + number, errors
    line = errors.splitlines()[-1]
    step = int((run / "train.csv").read_text().splitlines()[-1].split(",")[0])
    assert line.startswith("t2m: error: ") and f"stopped by {name} after step {step}, which is kept" in line
    assert names(run) == {f"{step}"} and not list(tmp_path.glob(".*"))
    last = ["--loop.num-steps", f"{step + 5}", "--loop.checkpoint_every", "0"]
    finish(training, "--resume", *last)
    finish(training, "--run", f"{tmp_path / 'whole'}", *last)
    assert_same_checkpoint(run, tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.release
@pytest.mark.parametrize("training", ["vqvae"], indirect=True)
def test_only_one_process_trains_a_run(training, tmp_path):
    first = start(training)
    wait_for(first, lambda: names(tmp_path / "run"))
    second = start(training, "--resume")
    errors = second.communicate(timeout=PATIENCE)[1]
    assert second.returncode == 2 and f"is being written by process {first.pid}" in errors.splitlines()[-1]
    assert first.poll() is None
    kill(first)
    finish(training, "--resume", "--loop.num-steps", f"{newest(tmp_path / 'run', tmp_path) + 2}")
