"""Peaks of small probes and tiny reports, so that no test measures anything large."""

import jax
import pytest

from t2m_jax.bench import probes
from t2m_jax.bench import timing as timing_module
from t2m_jax.bench.record import BenchReport, BenchResult, Figure, Machine, Peaks
from tests.cli.conftest import bundle_folder, data_folder, no_cache, refusal

__all__ = ["bundle_folder", "data_folder", "no_cache", "refusal"]

PEAKS = Peaks(num_devices=1, float32=2e11, bfloat16=1e11, memory=1e10)
MACHINE = Machine(
    device_kind="cpu", num_devices=1, processor="Abacus", num_cores=2, jax_version="0.10.2", peaks=(PEAKS,)
)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    jax.devices()  # so that `--devices` does not change the number of devices of the other tests
    cache = jax.config.values["jax_enable_compilation_cache"]
    monkeypatch.setattr(timing_module, "MIN_SECONDS", 0.0)
    monkeypatch.setattr(timing_module, "REPEATS", 1)
    monkeypatch.setattr(probes, "PRODUCT_SIZES", (16, 32))
    monkeypatch.setattr(probes, "ARRAY_SIZES", (1024,))
    yield
    jax.config.update("jax_enable_compilation_cache", cache)


def report(**values) -> BenchReport:
    """Returns a report of one row: `updates` (more is better), `compile` (less) and `loss` (neither)."""
    spread = values.pop("spread", 0.0)
    kinds = {"updates": ("1/s", "more"), "compile": ("s", "less"), "loss": ("", "neither")}
    values = {"updates": 10.0, "compile": 4.0, "loss": 1.0} | values
    figures = tuple(
        Figure(name=name, value=value, unit=kinds[name][0], better=kinds[name][1], spread=spread)
        for name, value in values.items()
    )
    row = BenchResult(benchmark="train", name="gpt tiny", figures=figures)
    return BenchReport(machine=MACHINE, rows=(row,), peak_memory=2e9, date="2026-11-21")
