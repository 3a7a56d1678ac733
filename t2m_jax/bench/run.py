"""What `t2m bench all` measures, and reports of measurements on several numbers of devices."""

from collections.abc import Callable, Sequence

import jax
from jax.sharding import Mesh

from t2m_jax.bench.data import benchmark_opening, benchmark_windows
from t2m_jax.bench.evaluate import benchmark_embedding
from t2m_jax.bench.probes import describe_machine, first_devices, measure_peaks
from t2m_jax.bench.record import BenchReport, BenchResult, Peaks
from t2m_jax.bench.sample import TOKENIZERS, benchmark_sampling, full_size_systems
from t2m_jax.bench.timing import peak_memory
from t2m_jax.bench.train import Kind, Options, benchmark_training, make_training
from t2m_jax.models.evaluator import EvaluatorConfig

BATCHES = (1, 32)
"""Batches of sampling."""


def make_report(
    measure: Callable[[Peaks], Sequence[BenchResult]],
    *,
    devices: Sequence[int],
    probe: Callable[[Mesh], Peaks] = measure_peaks,
) -> BenchReport:
    """Returns the report of a measurement on each number of devices.

    Args:
        measure: From the peaks of some devices, whose number they contain, to rows.
        devices: Numbers of devices.
        probe: From the mesh of some devices to their peaks.

    Raises:
        UserError: There are not so many devices.
    """
    meshes = [first_devices(count) for count in devices]
    # Peaks are measured right before the work, because the speed of a shared machine changes.
    found = [probe(mesh) for mesh in meshes]
    rows = tuple(row for peak in found for row in measure(peak))
    return BenchReport(machine=describe_machine(found), rows=rows, peak_memory=peak_memory())


def measure_all(peaks: Peaks, *, data: str | None = None, repeats: int = 3) -> list[BenchResult]:
    """Returns the rows of all benchmarks at full size, and those of opening a data set if its folder is given."""
    rows = [*_training(peaks, repeats), *_sampling(peaks, repeats)]
    mesh = first_devices(peaks.num_devices)
    rows += benchmark_embedding(EvaluatorConfig(), size="full", mesh=mesh, peaks=peaks, repeats=repeats)
    rows.append(benchmark_windows(num_devices=peaks.num_devices, peaks=peaks, repeats=repeats))
    return rows if data is None else [*rows, benchmark_opening(data, repeats=repeats)]


def _training(peaks: Peaks, repeats: int) -> list[BenchResult]:
    # Products of bfloat16 are slow on most CPUs.
    choices = [Options()] if jax.default_backend() == "cpu" else [Options(), Options(precision="bfloat16")]
    kinds: tuple[Kind, ...] = ("vqvae", "gpt")
    configs = [make_training(kind, "full", how, devices=peaks.num_devices) for kind in kinds for how in choices]
    return [benchmark_training(config, size="full", peaks=peaks, repeats=repeats) for config in configs]


def _sampling(peaks: Peaks, repeats: int) -> list[BenchResult]:
    mesh = first_devices(peaks.num_devices)
    return [
        benchmark_sampling(system, batch=batch, mesh=mesh, peaks=peaks, repeats=repeats)
        for system in full_size_systems(tuple(TOKENIZERS))
        for batch in BATCHES
        if batch % mesh.size == 0
    ]
