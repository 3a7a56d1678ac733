"""What `t2m bench all` measures, and reports of measurements on several numbers of devices."""

from collections.abc import Callable, Sequence

import jax

from t2m_jax.bench.data import benchmark_opening, benchmark_windows
from t2m_jax.bench.evaluate import benchmark_embedding
from t2m_jax.bench.probes import describe_machine, first_devices, measure_peaks
from t2m_jax.bench.record import BenchReport, BenchResult, Peaks
from t2m_jax.bench.sample import benchmark_sampling, full_size_systems
from t2m_jax.bench.timing import peak_memory
from t2m_jax.bench.train import benchmark_training, make_training
from t2m_jax.models.evaluator import EvaluatorConfig
from t2m_jax.models.rows import Precision

KINDS = ("vqvae", "gpt")
"""What is trained."""
BATCHES = (1, 32)
"""Batches of sampling."""


def make_report(measure: Callable[[Peaks], Sequence[BenchResult]], *, devices: Sequence[int]) -> BenchReport:
    """Returns the report of a measurement on each number of devices.

    Args:
        measure: From the peaks of some devices, whose number they contain, to rows.
        devices: Numbers of devices.

    Raises:
        UserError: There are not so many devices.
    """
    meshes = [first_devices(count) for count in devices]
    # Peaks are measured right before the work, because the speed of a shared machine changes.
    found = [measure_peaks(mesh) for mesh in meshes]
    rows = tuple(row for peak in found for row in measure(peak))
    return BenchReport(machine=describe_machine(found), rows=rows, peak_memory=peak_memory())


def measure_all(peaks: Peaks, *, data: str | None = None) -> list[BenchResult]:
    """Returns the rows of all benchmarks at full size, and those of opening a data set if its folder is given."""
    count = peaks.num_devices
    # Products of bfloat16 are slow on most CPUs.
    precisions: tuple[Precision, ...] = ("float32",) if jax.default_backend() == "cpu" else ("float32", "bfloat16")
    rows = [
        benchmark_training(make_training(kind, precision=precision, devices=count), size="full", peaks=peaks)
        for kind in KINDS
        for precision in precisions
    ]
    rows += [
        benchmark_sampling(system, batch=batch, peaks=peaks)
        for system in full_size_systems()
        for batch in BATCHES
        if batch % count == 0
    ]
    rows += benchmark_embedding(EvaluatorConfig(), peaks=peaks)
    rows.append(benchmark_windows(peaks=peaks))
    return rows if data is None else [*rows, benchmark_opening(data)]
