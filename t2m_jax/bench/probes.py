"""The machine: its devices, the highest rates that simple programs reach on them, and reports of what else they do."""

import os
import platform
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from t2m_jax.bench.record import BenchReport, BenchResult, Machine, Peaks
from t2m_jax.bench.timing import peak_memory, time_calls
from t2m_jax.devices import AXIS, make_data_mesh
from t2m_jax.errors import UserError

PRODUCT_SIZES = (1024, 2048, 4096, 8192)
"""Rows of the square matrices whose products are timed, on each device."""
ARRAY_SIZES = (2**26, 2**28)
"""Numbers in the arrays that are read and written: on each GPU or TPU, but on all devices of a CPU together, which
share its memory. The first fills more than its cache."""
LONG = 0.2
"""Seconds after which no larger size is tried."""


def first_devices(count: int, *, batch: int | None = None) -> Mesh:
    """Returns the mesh of the first devices, among which a batch can be divided.

    Raises:
        UserError: There are not so many, or they do not divide the batch.
    """
    available = jax.devices()
    if batch is not None and batch % count:
        raise UserError(f"bench: --batch {batch} is not a multiple of the {count} devices; change one of them")
    if not 1 <= count <= len(available):
        raise UserError(f"bench: --devices {count}, but there are {len(available)} ({available[0].device_kind})")
    return make_data_mesh(available[:count])


def place(tree: Any, mesh: Mesh, *, by_rows: bool = False) -> Any:
    """Returns arrays on the devices of a mesh: divided by rows, or all of them on each device."""
    return jax.device_put(tree, NamedSharding(mesh, PartitionSpec(AXIS) if by_rows else PartitionSpec()))


def product_rate(mesh: Mesh, dtype: Any) -> float:
    """Returns the highest FLOP/s of products of square matrices, of which each device multiplies its own."""
    multiply = jax.jit(jnp.matmul)

    # A product of n x n matrices has n³ multiplications and as many additions.
    def rate(size: int) -> tuple[float, float]:
        matrices = place(jnp.ones((mesh.size, size, size), dtype), mesh, by_rows=True)
        timing = time_calls(lambda: multiply(matrices, matrices))
        return timing.fastest, 2.0 * mesh.size * size**3

    return _best(rate, PRODUCT_SIZES)


def memory_rate(mesh: Mesh) -> float:
    """Returns the highest bytes/s at which the devices read and write an array."""
    # In place, because a CPU would spend most of the time with getting memory for a new array from the system.
    increase = jax.jit(lambda values: values + 1, donate_argnums=0)

    shared = mesh.size if jax.default_backend() == "cpu" else 1

    def rate(size: int) -> tuple[float, float]:
        numbers = place(jnp.ones((mesh.size, size // shared), jnp.float32), mesh, by_rows=True)

        def call() -> Any:
            nonlocal numbers
            numbers = increase(numbers)
            return numbers

        return time_calls(call).fastest, 2.0 * numbers.nbytes

    return _best(rate, ARRAY_SIZES)


def _best(rate: Callable[[int], tuple[float, float]], sizes: Sequence[int]) -> float:
    """Returns the highest rate of growing sizes; `rate` returns seconds and work."""
    # Small arrays do not fill a device, and large ones take long on a slow one.
    best = 0.0
    for size in sizes:
        seconds, work = rate(size)
        best = max(best, work / seconds)
        if seconds > LONG:
            break
    return best


def measure_peaks(mesh: Mesh) -> Peaks:
    """Returns the peaks of the devices of a mesh together. Virtual devices share the cores of the processor."""
    return Peaks(
        num_devices=mesh.size,
        float32=product_rate(mesh, jnp.float32),
        bfloat16=product_rate(mesh, jnp.bfloat16),
        memory=memory_rate(mesh),
    )


def on_devices(count: int) -> str:
    """Returns the end of a row's name that says on how many devices it was measured."""
    return f", {count} devices" if count > 1 else ""


def describe_machine(peaks: Sequence[Peaks]) -> Machine:
    """Returns the machine with its measured peaks."""
    devices = jax.devices()
    return Machine(
        device_kind=devices[0].device_kind,
        num_devices=len(devices),
        processor=_processor(),
        num_cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        jax_version=jax.__version__,
        peaks=tuple(peaks),
    )


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


def _processor() -> str:
    """Returns the name of the processor."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
