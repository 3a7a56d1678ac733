"""Programs of several updates: equal to single updates, compiled once, and where they run."""

import dataclasses
import logging
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import Mesh, PartitionSpec

from t2m_jax.data.banks.motions import make_bank
from t2m_jax.data.folder import Clip
from t2m_jax.devices import make_data_mesh
from t2m_jax.errors import UserError
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.train import OptimizerConfig, TrainEvaluatorConfig, TrainVqVaeConfig, program
from t2m_jax.train.config import ExperimentConfig, ShardingConfig, compiled_config
from t2m_jax.train.gpt import TrainGptConfig
from t2m_jax.train.hifigpt import TrainHiFiGptConfig
from t2m_jax.train.program import (
    Devices,
    Update,
    choose_devices,
    compile_updates,
    largest_share,
    many_updates,
    state_specs,
)
from t2m_jax.train.vqvae_config import TrainRvqVaeConfig
from tests.jit import assert_jit_equals_eager

ONE_DEVICE = Mesh(np.array(jax.devices()[:1]), ("data",))
SIZE = 5
"""Most updates of a call."""


class State(NamedTuple):
    """Something like a training state."""

    step: jax.Array
    params: dict
    opt_state: dict


def first():
    params = {"weights": jax.random.normal(jax.random.key(0), (4, 3))}
    return State(jnp.array(0, jnp.int32), params, jax.tree.map(jnp.zeros_like, params))


def descent(state, data, *, rate):
    """A descent with momentum, on numbers that differ from step to step."""
    noise = jax.random.normal(jax.random.fold_in(jax.random.key(1), state.step), data.shape)

    def objective(params):
        return jnp.mean(jnp.tanh((data + noise) @ params["weights"]) ** 2)

    loss, gradient = jax.value_and_grad(objective)(state.params)
    momentum = jax.tree.map(lambda old, new: 0.9 * old + new, state.opt_state, gradient)
    params = jax.tree.map(lambda old, change: old - rate * change, state.params, momentum)
    return State(state.step + 1, params, momentum), {"loss": loss, "number": state.step}


DATA = np.random.default_rng(0).normal(size=(8, 4)).astype(np.float32)


def assert_same(tree, other):
    jax.tree.map(np.testing.assert_array_equal, jax.device_get(tree), jax.device_get(other))


def run(counts, *, size=SIZE, mode="jit", update=None):
    """Returns the state after calls of the given numbers of updates, and the metrics of all updates."""
    devices = Devices(ShardingConfig(devices=1, mode=mode), batch_size=8)
    state, data, rows = devices.put_state(first()), devices.put_data(DATA), []
    for count in counts:
        state, metrics = devices.run(update or Update(descent, rate=0.1), state, data, count, size=size)
        rows.append(jax.tree.map(lambda values, count=count: np.asarray(values[:count]), metrics))
    return jax.device_get(state), jax.tree.map(lambda *values: np.concatenate(values), *rows)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_a_call_of_many_updates_equals_single_updates(count):
    update = Update(descent, rate=0.1)
    state, expected = first(), []
    single = jax.jit(update)
    for _ in range(count):
        state, metrics = single(state, DATA)
        expected.append(metrics)
    found, rows = jax.jit(many_updates, static_argnames=("update", "size"))(
        first(), DATA, jnp.array(count), update=update, size=SIZE
    )
    assert int(found.step) == count
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-7), found, state)
    assert rows["loss"].shape == (SIZE,)
    np.testing.assert_allclose(rows["loss"][:count], [metrics["loss"] for metrics in expected], rtol=1e-5)
    np.testing.assert_array_equal(rows["number"][:count], np.arange(count))
    np.testing.assert_array_equal(rows["loss"][count:], 0)


@pytest.mark.parametrize("mode", ["jit", "pmap"])
@pytest.mark.parametrize("counts", [(1, 5, 4), (2, 2, 2, 2, 2), (5, 3, 1, 1)])
def test_calls_that_are_cut_short_give_the_same_bits(mode, counts):
    """As in a training that stops and goes on, or that measures in between."""
    assert_same(run(counts, mode=mode), run((5, 5), mode=mode))


@pytest.mark.parametrize("mode", ["jit", "pmap"])
@pytest.mark.parametrize("size", [1, SIZE])
def test_a_program_is_compiled_once_for_all_counts_and_calls(mode, size):
    traces = []

    def counted(state, data, *, rate):
        traces.append(rate)
        return descent(state, data, rate=rate)

    run(range(1, size + 1), size=size, mode=mode, update=Update(counted, rate=0.1))
    # The shapes of the metrics are found by another trace.
    first_traces = len(traces)
    assert 1 <= first_traces <= 2
    run((size, 1, size), size=size, mode=mode, update=Update(counted, rate=0.1))
    assert len(traces) == first_traces, "an equal update was traced again"
    run((1,), size=size, mode=mode, update=Update(counted, rate=0.2))
    assert len(traces) == 2 * first_traces, "another update had the program of the first"


def test_updates_are_equal_if_function_and_options_are():
    update = Update(descent, rate=0.1)
    assert update == Update(descent, rate=0.1)
    assert hash(update) == hash(Update(descent, rate=0.1))
    assert update != Update(descent, rate=0.2)
    assert update != Update(first, rate=0.1)
    assert update != descent
    assert Update(descent, rate=1, other=2) == Update(descent, other=2, rate=1)


@pytest.mark.slow
@pytest.mark.parametrize("size", [1, 3])
def test_jit_equals_eager(size):
    compiled = compile_updates(Update(descent, rate=0.1), size=size, shares=1)
    with jax.set_mesh(make_data_mesh(jax.devices()[:1])):
        assert_jit_equals_eager(compiled, first(), jnp.asarray(DATA), jnp.array(min(size, 2)), atol=1e-7)


@pytest.mark.parametrize(
    ("shape", "count", "expected"),
    [
        ((8, 12), 4, PartitionSpec(None, "data")),
        ((12, 8), 4, PartitionSpec("data")),
        ((8, 8), 4, PartitionSpec("data")),
        ((6, 4, 9), 4, PartitionSpec(None, "data")),
        ((3, 5), 4, PartitionSpec()),
        ((), 4, PartitionSpec()),
        ((0, 3), 2, PartitionSpec()),
        ((7,), 1, PartitionSpec("data")),
    ],
)
def test_the_longest_axis_that_can_be_divided_is(shape, count, expected):
    assert largest_share(shape, count) == expected


def test_only_the_optimizer_s_state_is_divided():
    specs = state_specs(first(), shares=4)
    assert specs.opt_state == {"weights": PartitionSpec("data")}
    assert specs.params == {"weights": PartitionSpec()}
    assert specs.step == PartitionSpec()
    assert all(spec == PartitionSpec() for spec in jax.tree.leaves(state_specs(first(), shares=1)))


@pytest.fixture
def four_devices(monkeypatch):
    """Four devices that no program runs on."""
    found = [object() for _ in range(4)]
    monkeypatch.setattr(program.jax, "devices", lambda: found)
    return found


def chosen(monkeypatch, config, *, batch_size):
    """Returns the devices of a mesh that is asked for."""
    asked = []
    monkeypatch.setattr(program, "make_data_mesh", lambda devices: asked.append(devices) or ONE_DEVICE)
    choose_devices(config, batch_size=batch_size)
    return asked[0]


def test_more_devices_than_there_are_is_a_user_error(four_devices):
    with pytest.raises(UserError, match=r"^sharding\.devices: 5, but there are 4$"):
        choose_devices(ShardingConfig(devices=5), batch_size=10)


def test_devices_that_do_not_divide_the_batch_are_a_user_error(four_devices):
    with pytest.raises(UserError, match=r"^loop\.batch_size: 10 is not a multiple of the 4 devices; change one"):
        choose_devices(ShardingConfig(devices=4), batch_size=10)


@pytest.mark.parametrize(("batch_size", "count"), [(8, 4), (6, 3), (10, 2), (7, 1), (1, 1)])
def test_auto_takes_as_many_devices_as_divide_the_batch(four_devices, monkeypatch, caplog, batch_size, count):
    with caplog.at_level(logging.WARNING):
        assert chosen(monkeypatch, ShardingConfig(), batch_size=batch_size) == four_devices[:count]
    expected = [] if count == 4 else [f"{count} of 4 devices are used, because they divide the batch"]
    assert caplog.messages == expected


def test_a_given_number_takes_the_first_devices(four_devices, monkeypatch, caplog):
    assert chosen(monkeypatch, ShardingConfig(devices=2), batch_size=8) == four_devices[:2]
    assert not caplog.messages


def test_several_processes_need_all_devices(four_devices, monkeypatch):
    monkeypatch.setattr(program.jax, "process_count", lambda: 2)
    assert chosen(monkeypatch, ShardingConfig(), batch_size=8) == four_devices
    with pytest.raises(UserError, match=r"^sharding\.devices: 2, but there are 4$"):
        choose_devices(ShardingConfig(devices=2), batch_size=8)
    with pytest.raises(UserError, match=r"^loop\.batch_size: 6 is not a multiple of the 4 devices"):
        choose_devices(ShardingConfig(), batch_size=6)


@pytest.mark.parametrize("share", ["optimizer", "bank"])
def test_pmap_has_no_shares(share):
    with pytest.raises(ValueError, match=r"^mode: pmap has all"):
        ShardingConfig(mode="pmap", **{share: "sharded"})


@pytest.mark.parametrize("devices", [0, -1])
def test_a_number_of_devices_is_positive(devices):
    with pytest.raises(ValueError, match=r"^devices: "):
        ShardingConfig(devices=devices)


def test_data_on_a_cpu_share_the_memory_of_the_host(tmp_path):
    """A data set larger than half of the memory can be trained on."""
    whole = np.random.default_rng(0).normal(size=(64, 16)).astype(np.float32)
    np.save(tmp_path / "frames.npy", whole)
    mapped = np.load(tmp_path / "frames.npy", mmap_mode="r")
    bank = make_bank([Clip("a", mapped[:40], ()), Clip("b", mapped[40:], ())], Normalizer(whole[0], whole[1]))
    put = Devices(ShardingConfig(devices=1), batch_size=1).put_data(bank)
    assert put.frames.unsafe_buffer_pointer() == mapped.ctypes.data
    np.testing.assert_array_equal(put.frames, whole)


def test_a_state_is_donated():
    devices = Devices(ShardingConfig(devices=1), batch_size=1)
    state = devices.put_state(first())
    devices.run(Update(descent, rate=0.1), state, devices.put_data(DATA), 1, size=SIZE)
    assert all(leaf.is_deleted() for leaf in jax.tree.leaves(state))


@pytest.mark.parametrize(
    "schema", [TrainVqVaeConfig, TrainRvqVaeConfig, TrainGptConfig, TrainHiFiGptConfig, TrainEvaluatorConfig]
)
def test_a_step_sees_its_own_section_of_the_config_and_nothing_else(schema):
    config = schema()
    section = compiled_config(config)
    assert type(section) is schema.step
    assert not isinstance(section, ExperimentConfig)
    assert (section.model, section.optimizer) == (config.model, config.optimizer)
    for other in (
        {"run": Path("other"), "data": Path("moved"), "init": Path("demo"), "data_fraction": 0.5},
        {"loop": dataclasses.replace(config.loop, num_steps=7, log_every=3, steps_per_call=5)},
        {"sharding": ShardingConfig(mode="pmap"), "placement": "host"},
    ):
        assert compiled_config(dataclasses.replace(config, **other)) == section
    for other in (
        {"loop": dataclasses.replace(config.loop, seed=7)},
        {"loop": dataclasses.replace(config.loop, batch_size=2)},
        {"optimizer": OptimizerConfig(learning_rate=3.0)},
    ):
        assert compiled_config(dataclasses.replace(config, **other)) != section
