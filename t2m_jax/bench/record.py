"""The report of a benchmark: the machine, and measurements, whose figures have units."""

import dataclasses
import datetime
from pathlib import Path
from typing import Literal

from t2m_jax.config import config_from_dict, config_to_dict
from t2m_jax.errors import UserError
from t2m_jax.files.manifest import load_sealed_json, save_sealed_json

FORMAT_VERSION = 1
"""Version of the files that `save_report` writes."""
Benchmark = Literal["train", "sample", "evaluate", "data"]
"""What is measured."""


class _Shown:
    """A record that terminals show: its texts must not move the cursor."""

    def __post_init__(self) -> None:
        for text in vars(self).values():
            if isinstance(text, str) and not text.isprintable():
                raise ValueError(f"{text!r} has characters that cannot be printed")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Peaks:
    """The highest rates that simple programs reach on some devices of the machine together."""

    num_devices: int
    """Number of devices that were used."""
    float32: float
    """Matrix products of float32 numbers in the precision that JAX uses by default, in FLOP/s."""
    bfloat16: float
    """Matrix products of bfloat16 numbers, in FLOP/s."""
    memory: float
    """Reading and writing of device memory, in bytes/s."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Machine(_Shown):
    """What a report was measured on."""

    device_kind: str
    """Name that JAX gives the devices, such as `cpu`."""
    num_devices: int
    """Number of devices."""
    processor: str
    """Name of the processor."""
    num_cores: int
    """Processor cores that the process may use."""
    jax_version: str
    """Version of JAX."""
    peaks: tuple[Peaks, ...]
    """For each number of devices that was measured."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Figure(_Shown):
    """A number with its unit."""

    name: str
    """What it is."""
    value: float
    """The median of all repeats if it is a time or a rate."""
    unit: str = ""
    """Unit; empty for a ratio or a count."""
    better: Literal["more", "less", "neither"] = "neither"
    """What an improvement is. `neither` is for figures that describe the work or follow from another figure."""
    spread: float = 0.0
    """Distance of the upper and the lower quartile of all repeats, relative to the median."""

    @property
    def heading(self) -> str:
        """The name with the unit."""
        return f"{self.name} ({self.unit})" if self.unit else self.name


@dataclasses.dataclass(frozen=True, kw_only=True)
class BenchResult(_Shown):
    """The figures of one measurement."""

    benchmark: Benchmark
    """What it measures."""
    name: str
    """What was run, with all settings that affect the figures."""
    figures: tuple[Figure, ...]
    """Figures; their names differ."""

    def __getitem__(self, name: str) -> Figure:
        """Returns the figure of a name. Raises `KeyError` if there is none."""
        return {figure.name: figure for figure in self.figures}[name]


@dataclasses.dataclass(frozen=True, kw_only=True)
class BenchReport(_Shown):
    """From `t2m bench` to `report_text` and the file of `--json`: the measurements of one run."""

    machine: Machine
    """Where they were measured."""
    rows: tuple[BenchResult, ...]
    """What was measured, a line of the tables for each."""
    peak_memory: float | None
    """Most memory that the process used, in bytes: of its first device, or on a CPU of the process. None if unknown."""
    date: str = dataclasses.field(default_factory=lambda: datetime.date.today().isoformat())
    """Day of the measurement."""
    format_version: int = FORMAT_VERSION
    """Version of the file."""


def save_report(path: str | Path, report: BenchReport) -> None:
    """Writes a report as JSON."""
    save_sealed_json(path, config_to_dict(report))


def load_report(path: str | Path) -> BenchReport:
    """Returns the report in a file.

    Raises:
        UserError: The file is missing, or is something else.
    """
    # A report may come from somewhere else: the version first, so that the error is about the right thing.
    data = load_sealed_json(path, entries=[field.name for field in dataclasses.fields(BenchReport)])
    if data.get("format_version") != FORMAT_VERSION:
        expected = f"a benchmark report of format_version {FORMAT_VERSION}"
        raise UserError(f"{path}: is not {expected}; write one with `t2m bench all --json`")
    return config_from_dict(BenchReport, data, source=f"{path}")
