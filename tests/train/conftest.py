"""A data set, a trained VQ-VAE and a trained GPT, all tiny, made once for the tests of this folder."""

from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import orbax.checkpoint as ocp
import pytest

from t2m_jax.checkpoints.run import CHECKPOINTS, Checkpoints
from t2m_jax.data.importers.synthetic import write_synthetic_dataset
from t2m_jax.train import train
from t2m_jax.train.program import Devices
from tests.tiny import gpt_training, vqvae_training


class Runs(NamedTuple):
    """Finished runs; nobody may write into them."""

    data: Path
    vqvae: Path
    gpt: Path


@pytest.fixture(scope="session", autouse=True)
def no_compilation_cache():
    """Keeps programs in memory alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("T2M_JAX_NO_COMPILATION_CACHE", "1")
        yield


@pytest.fixture(scope="session")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("training") / "data"
    write_synthetic_dataset(folder, num_clips=20, seed=3)
    return folder


@pytest.fixture(scope="session")
def runs(data) -> Runs:
    """Both stages, trained without a stop; the VQ-VAE's folder was moved after the GPT had been trained on it."""
    first, vqvae, gpt = data.parent / "first", data.parent / "moved", data.parent / "gpt"
    train(vqvae_training(data, first))
    train(gpt_training(data, first, gpt))
    first.rename(vqvae)
    return Runs(data, vqvae, gpt)


def pytest_collection_modifyitems(items):
    """Makes tests slow that need `runs`, because trainings take longest to compile."""
    for item in items:
        if "runs" in item.fixturenames:
            item.add_marker(pytest.mark.slow)


def stop_at(step, monkeypatch, *, is_meant=lambda state: True):
    """Interrupts training in the given update, as Ctrl-C would, and returns what ends this.

    `is_meant` tells the training by its state, if there are several.
    """
    run = Devices.run

    def interrupted(devices, update, state, data, count, *, size):
        if is_meant(state) and int(state.step) < step <= int(state.step) + count:
            raise KeyboardInterrupt
        return run(devices, update, state, data, count, size=size)

    monkeypatch.setattr(Devices, "run", interrupted)
    return lambda: monkeypatch.setattr(Devices, "run", run)


def skip_updates(monkeypatch):
    """Lets trainings count their updates without changing the weights: to compile an update takes longest."""

    def counted(devices, update, state, data, count, *, size):
        return state._replace(step=state.step + count), {"loss": np.zeros(size, np.float32)}

    monkeypatch.setattr(Devices, "run", counted)


def newest_checkpoint(run: Path):
    """Returns the step of a run's newest checkpoint and what is in it."""
    with Checkpoints(run) as checkpoints:
        step = checkpoints.newest_intact()[0]
    return step, read_checkpoint(run, step)


def read_checkpoint(run: Path, step: int):
    """Returns everything in a checkpoint, by field."""
    folders = [path for path in (run / CHECKPOINTS / f"{step}").iterdir() if path.is_dir()]
    with ocp.StandardCheckpointer() as reader:
        return {folder.name: reader.restore(folder.resolve()) for folder in sorted(folders)}


def assert_same_checkpoint(run: Path, other: Path) -> None:
    """Fails where two runs do not end in the same state, bit for bit."""
    (step, tree), (other_step, other_tree) = newest_checkpoint(run), newest_checkpoint(other)
    assert step == other_step
    assert jax.tree.structure(tree) == jax.tree.structure(other_tree)
    assert len(jax.tree.leaves(tree)) > 20
    jax.tree.map(np.testing.assert_array_equal, tree, other_tree)
