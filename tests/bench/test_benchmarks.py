"""Each benchmark of a tiny model gives figures that make sense. No test looks at a time."""

import dataclasses
import math
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest
from flax.traverse_util import flatten_dict

from t2m_jax.bench import data as data_module
from t2m_jax.bench import evaluate as evaluate_module
from t2m_jax.bench import sample as sample_module
from t2m_jax.bench import timing as timing_module
from t2m_jax.bench.data import benchmark_opening, benchmark_windows
from t2m_jax.bench.evaluate import benchmark_embedding
from t2m_jax.bench.probes import first_devices, memory_rate, product_rate
from t2m_jax.bench.record import Figure
from t2m_jax.bench.sample import MeasuredSystem, benchmark_sampling, random_variables
from t2m_jax.bench.timing import Timing, time_calls
from t2m_jax.bench.train import benchmark_training, make_training, update_flops
from t2m_jax.errors import UserError
from t2m_jax.models.system import variable_shapes
from t2m_jax.train import LoopConfig
from tests import tiny
from tests.bench.conftest import PEAKS

pytestmark = pytest.mark.slow


def check(row, *names):
    assert set(names) <= {figure.name for figure in row.figures}
    assert len({figure.name for figure in row.figures}) == len(row.figures)
    for figure in row.figures:
        assert math.isfinite(figure.value) and figure.value > 0, figure


def test_probes_find_positive_rates():
    mesh = first_devices(1)
    assert 0 < product_rate(mesh, jnp.bfloat16) < math.inf
    assert 0 < memory_rate(mesh) < math.inf


def test_devices_that_do_not_exist_are_refused():
    with pytest.raises(UserError, match="--devices 100, but there are"):
        first_devices(100)


def test_a_call_is_repeated_after_one_that_does_not_count(monkeypatch):
    monkeypatch.setattr(timing_module, "REPEATS", 4)
    calls = []
    assert time_calls(lambda: calls.append(1)).median > 0
    assert len(calls) == 5


def test_training_of_a_vqvae():
    config = tiny.vqvae_training(Path(), Path(), loop=LoopConfig(batch_size=4, steps_per_call=2))
    row = benchmark_training(config, size="tiny", peaks=PEAKS)
    check(row, "updates", "frames", "compile", "memory per device", "work", "of product peak", "first loss")
    assert row["frames"].value == pytest.approx(row["updates"].value * 4 * 32)
    assert row.name == "vqvae tiny 4x32 float32"


@pytest.mark.release
def test_training_of_a_gpt():
    plain = tiny.gpt_training(Path(), Path(), Path(), loop=LoopConfig(batch_size=4))
    config = dataclasses.replace(plain, text_encoder="clip", remat=True, num_parts=2, precision="bfloat16")
    row = benchmark_training(config, size="tiny", peaks=PEAKS)
    check(row, "updates", "frames", "compile", "memory per device", "work", "of product peak", "first loss")
    assert row.name == "gpt tiny 4x41 bfloat16"
    assert update_flops(config) == update_flops(dataclasses.replace(config, remat=False, num_parts=1))


def tiny_system(generator, tokenizer, **options):
    variables = {"generator": random_variables(generator), "tokenizer": random_variables(tokenizer)}
    return MeasuredSystem("tiny", generator, tokenizer, variables, **options)


def test_sampling(monkeypatch):
    sizes = []

    def encode_and_decode(system, size, **options):
        sizes.append(size)
        return Figure(name="encode + decode", value=1.0)

    monkeypatch.setattr(sample_module, "encode_and_decode", encode_and_decode)
    system = tiny_system(tiny.GPT, tiny.VQVAE)
    monkeypatch.setattr(sample_module, "NUM_CODES", 9)
    row = benchmark_sampling(system, batch=3, peaks=PEAKS)
    names = ("per step", "per row", "per frame", "codes", "encode + decode", "compile")
    check(row, *names, "of product peak", "of memory peak")
    assert row["per step"].value == pytest.approx(3 * row["per row"].value)
    assert row["per row"].value == pytest.approx(4 * row["per frame"].value)
    assert row.name == "tiny, 9 rows, batch 3"
    assert sizes == [(3, 9 * 4)], "as many frames as are sampled"


@pytest.mark.release
def test_sampling_with_several_codes_per_row():
    system = tiny_system(tiny.HIFIGPT, tiny.RVQVAE, guidance_scale=3.0)
    row = benchmark_sampling(system, batch=2, peaks=PEAKS)
    assert row.name == "tiny, 20 rows, batch 2", "no motion is longer"
    assert row["codes"].value == pytest.approx(3 * 1e3 / row["per row"].value)
    assert row["per row"].value == pytest.approx(8 * row["per frame"].value)
    kernels = flatten_dict(system.variables["generator"]["params"], sep="/")
    repeats = {"temporal": 1, "residual": 3, "head": 3}
    read = sum(repeats.get(name.split("/")[0], 0) * leaf.nbytes for name, leaf in kernels.items() if leaf.ndim == 2)
    moved = row["of memory peak"].value / 100 * PEAKS.memory * row["per step"].value / 1e3
    assert 1 < moved / read < 1.4, "each depth reads the weights of its tier again; caches are small"


def test_encoding_and_decoding(monkeypatch):
    """The time of a frame is that of the whole batch divided by its frames, and the batch comes back at its length."""
    results = []

    def time_once(call):
        results.append(call())
        return Timing(median=6.0, fastest=6.0, spread=0.5)

    monkeypatch.setattr(sample_module, "time_calls", time_once)
    system = tiny_system(tiny.GPT, tiny.VQVAE)
    figure = sample_module.encode_and_decode(system, (3, 20), mesh=first_devices(1))
    (motion,) = results
    assert motion.shape == (3, 20, 263) and jnp.isfinite(motion).all()
    assert (figure.unit, figure.spread) == ("ms/frame", 0.5)
    assert figure.value == pytest.approx(1e3 * 6.0 / (3 * 20))


def test_embedding(monkeypatch):
    monkeypatch.setattr(evaluate_module, "BATCH", 2)
    monkeypatch.setattr(evaluate_module, "FRAMES", 8)
    rows = benchmark_embedding(tiny.EVALUATOR, peaks=PEAKS)
    assert [row.name for row in rows] == ["motions, 2x8", "captions, 2x22"]
    for row in rows:
        check(row, "speed", "compile", "of product peak")


def test_windows_and_opening(monkeypatch, data_folder):
    monkeypatch.setattr(data_module, "BATCH", 2)
    check(benchmark_windows(peaks=PEAKS), "speed", "of memory peak")
    check(benchmark_opening(data_folder), "speed", "first opening")


@pytest.mark.release
@pytest.mark.parametrize("kind", ["rvqvae", "hifigpt"])
def test_training_of_the_second_system(kind):
    loop = {"loop": LoopConfig(batch_size=4)}
    if kind == "rvqvae":
        config = dataclasses.replace(make_training("rvqvae"), model=tiny.RVQVAE, **loop)
        shape, frames = "4x32", 4 * 32
    else:
        config = make_training("hifigpt")
        config = dataclasses.replace(config, model=tiny.HIFIGPT, **loop)
        shape, frames = f"4x{tiny.HIFIGPT.max_codes}x{tiny.HIFIGPT.num_quantizers}", 4 * tiny.HIFIGPT.max_codes * 8
    row = benchmark_training(config, size="tiny", peaks=PEAKS)
    check(row, "updates", "frames", "compile", "memory per device", "work", "of product peak", "first loss")
    assert row.name == f"{kind} tiny {shape} float32"
    assert row["frames"].value == pytest.approx(row["updates"].value * frames)


def test_updates_have_more_operations_with_a_larger_batch():
    small, large = (
        update_flops(tiny.vqvae_training(Path(), Path(), loop=LoopConfig(batch_size=batch))) for batch in (2, 4)
    )
    assert large == pytest.approx(2 * small, rel=0.2)


def test_small_models_of_both_systems_are_about_as_large():
    tokenizers = [make_training(kind, "demo").model for kind in ("vqvae", "rvqvae")]
    one, other = (
        sum(math.prod(leaf.shape) for leaf in jax.tree.leaves(variable_shapes(sizes)["params"])) for sizes in tokenizers
    )
    assert one == pytest.approx(other, rel=0.05)


@pytest.mark.parametrize("kind", ["vqvae", "gpt", "rvqvae", "hifigpt"])
def test_small_models_are_those_of_the_configs(kind):
    config = make_training(kind, "demo", batch=8, precision="bfloat16", devices=2)
    assert config.kind == kind
    assert (config.loop.batch_size, config.precision, config.sharding.devices) == (8, "bfloat16", 2)


def test_a_full_generator_has_a_smaller_batch_on_a_cpu():
    assert make_training("gpt", "demo").loop.batch_size == 64
    assert jax.default_backend() != "cpu" or make_training("gpt").loop.batch_size == 16
