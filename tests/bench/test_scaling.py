import math

import pytest

from t2m_jax.bench.record import BenchReport, BenchResult, Figure
from t2m_jax.bench.scaling import (
    INTERCONNECTS,
    Recipe,
    all_reduce_seconds,
    assumed_rates,
    measured_rates,
    predict,
    published_recipes,
    scaling_rows,
)
from t2m_jax.bench.train import BATCHES, Options, make_training, update_flops
from t2m_jax.errors import UserError
from tests.bench.conftest import MACHINE

RECIPE = Recipe("by hand", flops=1e12, num_parameters=250_000_000)


def test_one_accelerator_only_computes():
    assert predict(RECIPE, rate=1e14, count=1, interconnect="ethernet") == (0.01, 0)


def test_a_ring_by_hand():
    """Four accelerators: a quarter of the work, and 1.5 times 1 GB at 12.5 GB/s in 6 messages of 30 microseconds."""
    found = predict(RECIPE, rate=1e14, count=4, interconnect="ethernet")
    assert found.compute == pytest.approx(0.0025)
    assert found.communication == pytest.approx(1.5 / 12.5 + 6 * 30e-6)
    assert found.total == pytest.approx(0.0025 + 0.12018)


def test_machines_with_nvlink_are_connected_by_infiniband():
    """16 accelerators: 1.75 GB inside a machine, and 2 (2 - 1) / 2 of an eighth of 1 GB between two machines."""
    inside = 2 * 7 / 8 / 450 + 14 * INTERCONNECTS["nvlink"].latency
    between = 0.125 / 50 + 2 * INTERCONNECTS["infiniband"].latency
    assert all_reduce_seconds(1e9, 8, "nvlink") == pytest.approx(inside)
    assert all_reduce_seconds(1e9, 16, "nvlink") == pytest.approx(inside + between)


def test_communication_that_dominates_is_marked():
    rows = scaling_rows({"vqvae": 1e14, "gpt": 1e14}, interconnect="ethernet", counts=(1, 64))
    assert [row[3].startswith("**") for row in rows] == [False, True, False, True]
    assert [row[5] for row in rows if row[1] == "1"] == ["1.0", "1.0"]


def test_the_recipes_have_the_published_sizes():
    recipes = published_recipes()
    assert 15e6 < recipes["vqvae"].num_parameters < 25e6
    assert 225e6 < recipes["gpt"].num_parameters < 232e6
    assert recipes["rvqvae"].num_parameters == pytest.approx(21.9e6, rel=0.01)
    assert recipes["hifigpt"].num_parameters == pytest.approx(57.7e6, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["vqvae", "gpt", "rvqvae", "hifigpt"])
def test_the_recipes_have_the_counted_operations(kind):
    recipe = make_training(kind, "full", Options(batch=BATCHES[kind, "full"]))
    assert math.isclose(update_flops(recipe), published_recipes()[kind].flops, rel_tol=0.005)


def row(kind: str, updates: float, name: str = "") -> BenchResult:
    figures = (Figure(name="updates", value=updates, unit="1/s"), Figure(name="work", value=2.0, unit="TFLOP/update"))
    return BenchResult(benchmark="train", name=f"{kind} full 8x8 float32{name}", figures=figures)


def test_measured_rates_are_of_the_fastest_row_on_one_device():
    rows = (row("vqvae", 3.0), row("vqvae", 5.0, ", 4 updates per call"), row("vqvae", 9.0, ", 8 devices"))
    report = BenchReport(machine=MACHINE, rows=(*rows, row("gpt", 0.5)), peak_memory=1.0)
    assert measured_rates(report) == {"vqvae": 1e13, "gpt": 1e12}
    assert measured_rates(BenchReport(machine=MACHINE, rows=rows, peak_memory=1.0)) == {"vqvae": 1e13}
    assert {cells[0] for cells in scaling_rows({"vqvae": 1e13}, interconnect="pcie")} == {"VQ-VAE, 256x64"}
    with pytest.raises(UserError, match="has no training of full size"):
        measured_rates(BenchReport(machine=MACHINE, rows=rows[2:], peak_memory=1.0))


@pytest.mark.parametrize("kind", ["vqvae", "gpt"])
def test_the_prediction_for_one_device_is_what_was_measured(kind):
    """A row with the recipe's operations per update: the predicted update takes as long as the measured one."""
    recipe = published_recipes()[kind]
    rate = 2.5 * recipe.flops  # FLOP/s at 2.5 updates per second
    assert predict(recipe, rate=rate, count=1, interconnect="pcie").total == pytest.approx(1 / 2.5)


def test_unknown_names_are_refused():
    with pytest.raises(UserError, match="device 'abacus' is unknown; known: h200"):
        assumed_rates("abacus")
    with pytest.raises(UserError, match="interconnect 'string' is unknown; known: nvlink"):
        scaling_rows(assumed_rates("h200"), interconnect="string")
