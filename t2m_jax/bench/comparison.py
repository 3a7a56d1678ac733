"""Regressions: figures of a report that are worse than in an earlier report of the same machine."""

from typing import NamedTuple

from t2m_jax.bench.record import BenchReport, Figure, Machine
from t2m_jax.errors import UserError

SAME = ("device_kind", "num_devices", "processor", "num_cores")
"""Fields of the machine that two reports must share. Versions may differ, because they may cause a regression."""


class Regression(NamedTuple):
    """A figure that became worse."""

    row: str
    """Benchmark and name of the row."""
    before: Figure
    after: Figure

    def __str__(self) -> str:
        change = self.after.value / self.before.value - 1
        return f"{self.row}: {self.after.heading} {self.before.value:.4g} -> {self.after.value:.4g} ({change:+.0%})"


class Comparison(NamedTuple):
    """Two reports."""

    regressions: tuple[Regression, ...]
    num_compared: int
    """Figures that both reports have."""


def check_same_machine(before: Machine, after: Machine) -> None:
    """Raises `UserError` if the rates of two machines cannot be compared."""
    for name in SAME:
        one, other = getattr(before, name), getattr(after, name)
        if one != other:
            raise UserError(f"{name}: the stored report has {one!r}, this machine {other!r}; compare on one machine")


def compare_reports(before: BenchReport, after: BenchReport, *, tolerance: float) -> Comparison:
    """Returns the regressions of a report among the figures that both reports have.

    Args:
        before: The earlier report.
        after: The later report.
        tolerance: By how much a figure may be worse, relative to the earlier one. A larger spread of its repeats in one
            of the reports counts instead.

    Raises:
        UserError: The reports are of different machines.
    """
    check_same_machine(before.machine, after.machine)
    earlier = {(row.benchmark, row.name, figure.name): figure for row in before.rows for figure in row.figures}
    regressions, compared = [], 0
    for row in after.rows:
        for figure in row.figures:
            old = earlier.get((row.benchmark, row.name, figure.name))
            if old is None or figure.better == "neither" or min(old.value, figure.value) <= 0:
                continue
            compared += 1
            slowdown = figure.value / old.value if figure.better == "less" else old.value / figure.value
            if slowdown - 1 > max(tolerance, old.spread, figure.spread):
                regressions.append(Regression(f"{row.benchmark} {row.name}", old, figure))
    return Comparison(tuple(regressions), compared)
