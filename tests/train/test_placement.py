"""Training with data on the host: what it learns is the same to the last bit."""

import dataclasses

import jax
import pytest

from t2m_jax.errors import UserError
from t2m_jax.train import placement, train
from t2m_jax.train.config import LoopConfig, ShardingConfig
from t2m_jax.train.evaluator_config import TrainEvaluatorConfig
from t2m_jax.train.placement import DataOnDevices, DataOnHost, place_data
from t2m_jax.train.program import Devices
from t2m_jax.train.vqvae import prepare
from tests.jit import process_of_user
from tests.tiny import EVALUATOR, vqvae_training
from tests.train.conftest import assert_same_checkpoint

LOOP = LoopConfig(num_steps=20, batch_size=4, seed=5, log_every=7, validate_every=6, checkpoint_every=12)
"""Calls of five steps that are cut short, and several epochs of training."""


def evaluator_training(data, run, *, loop):
    return TrainEvaluatorConfig(
        data=data,
        run=run,
        model=EVALUATOR,
        window=24,
        min_count=1,
        decoder_hidden=10,
        movement_steps=7,
        movement_batch_size=3,
        loop=dataclasses.replace(loop, num_steps=7),
    )


def tables(run):
    return {str(path.relative_to(run)): path.read_bytes() for path in run.rglob("*.csv") if path.name != "speed.csv"}


@pytest.mark.slow
@pytest.mark.release
@pytest.mark.parametrize(("make_config", "steps_per_call"), [(vqvae_training, 1), (evaluator_training, 5)])
def test_the_place_of_the_data_changes_nothing(data, tmp_path, make_config, steps_per_call, monkeypatch):
    loop = dataclasses.replace(LOOP, steps_per_call=steps_per_call)
    # The programs of the two places are not the same, so rounding may differ with XLA's options in tests.
    with process_of_user(monkeypatch) as process:
        for name in ("device", "host"):
            config = dataclasses.replace(make_config(data, tmp_path / name, loop=loop), placement=name)
            process.submit(train, config).result()
    found = tables(tmp_path / "host")
    assert {"train.csv", "val.csv"} <= found.keys()
    assert found == tables(tmp_path / "device")
    assert_same_checkpoint(tmp_path / "host", tmp_path / "device")


@pytest.mark.slow
def test_a_run_may_be_resumed_with_the_data_elsewhere(data, tmp_path):
    config = vqvae_training(data, tmp_path / "whole", loop=LOOP)
    train(config)
    config = dataclasses.replace(config, run=tmp_path / "parts")
    for steps, where in ((6, "device"), (13, "host"), (20, "device")):
        loop = dataclasses.replace(LOOP, num_steps=steps)
        train(dataclasses.replace(config, placement=where, loop=loop), resume=steps > 6)
    assert_same_checkpoint(tmp_path / "whole", tmp_path / "parts")


@pytest.fixture
def setup(data, tmp_path):
    return prepare(vqvae_training(data, tmp_path, loop=LOOP), False)


def place(setup, where, **sharding):
    return place_data(setup.data, setup.plan, Devices(ShardingConfig(**sharding), batch_size=4), where, batch_size=4)


def test_auto_decides_by_size(setup, monkeypatch):
    size = setup.data.frames.nbytes
    for free, kind in ((2.1 * size, DataOnDevices), (1.9 * size, DataOnHost)):
        monkeypatch.setattr(placement, "device_memory", lambda device, free=free: free)
        assert isinstance(place(setup, "auto"), kind)
    assert isinstance(place(setup, "device"), DataOnDevices)
    assert isinstance(place(dataclasses.replace(setup, plan=None), "host"), DataOnDevices)


def test_the_device_gets_windows_and_no_frames(setup):
    with place(setup, "host").feed(0, 20, size=5) as take:
        data = take(2)
    shapes = [leaf.shape for leaf in jax.tree.leaves(data)]
    assert (5, 4, 32, 263) in shapes
    assert not any(shape[:1] == setup.data.frames.shape[:1] for shape in shapes if shape)


def test_pmap_cannot_be_fed(setup, monkeypatch):
    with pytest.raises(UserError, match="use --sharding"):
        place(setup, "host", mode="pmap")
    monkeypatch.setattr(placement, "device_memory", lambda device: 1000)
    with pytest.raises(UserError, match="--placement device"):
        place(setup, "auto", mode="pmap")
