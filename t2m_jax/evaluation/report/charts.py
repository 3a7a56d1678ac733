"""Figures of tables and of trainings, by matplotlib, which the extra `plot` installs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from t2m_jax.errors import UserError
from t2m_jax.evaluation.report.formats import facts_text, heading
from t2m_jax.evaluation.report.tables import Table
from t2m_jax.files.writing import atomic_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PANELS = 4
"""Most panels side by side."""
SUFFIXES = (".png", ".svg", ".pdf")
DPI = 150


class MetricCurve(NamedTuple):
    """A metric of a run at some of its steps."""

    steps: Sequence[int]
    values: Sequence[float]


def check_chart(path: Path) -> None:
    """Raises `UserError` if a figure cannot be written to a file of this name, or not without the extra `plot`."""
    if path.suffix not in SUFFIXES:
        raise UserError(f"{path}: is not a name for a figure; give a file that ends in {', '.join(SUFFIXES)}")
    try:
        import matplotlib as matplotlib
    except ImportError as error:
        raise UserError(f"{path}: figures need the extra `plot`: pip install 't2m-jax[plot]'") from error


def table_chart(table: Table) -> "Figure":
    """Returns a panel for each column: the models with their 95 % intervals, and a dashed line for real motion."""
    real, *models = table.lines
    rows = -(-len(table.columns) // PANELS)
    figure = _figure(3.0 * min(len(table.columns), PANELS), rows * (1.2 + 0.35 * len(models)) + 0.5)
    panels = figure.subplots(rows, min(len(table.columns), PANELS), sharey=True, squeeze=False).ravel()
    for panel, column in zip(panels, table.columns, strict=False):
        panel.set_title(heading(column), fontsize="medium")
        for row, line in enumerate(models):
            if cell := line.cells.get(column.metric):
                style = {"fmt": "o", "capsize": 3, "color": f"C{row % 10}", "markersize": 7 if cell.best else 5}
                panel.errorbar(cell.mean, row, xerr=cell.interval, **style)
        if cell := real.cells.get(column.metric):
            panel.axvline(cell.mean, color="gray", linestyle="--", linewidth=1)
        panel.set_yticks(range(len(models)), [_plain(line.name) for line in models])
        panel.set_ylim(len(models) - 0.5, -0.5)
        panel.grid(axis="x", alpha=0.3)
    for panel in panels[len(table.columns) :]:
        panel.remove()
    figure.supxlabel(_plain(f"{facts_text(table)} Dashed: real motion."), fontsize="x-small", wrap=True)
    return figure


def curves_chart(curves: Mapping[str, Mapping[str, MetricCurve]], *, metric: str) -> "Figure":
    """Returns the curves of runs in one panel, each run in its color: `train` pale, `val` and others strong.

    Args:
        curves: Curves by run and by split.
        metric: What they show.
    """
    figure = _figure(8, 5)
    panel = figure.subplots()
    for number, (run, splits) in enumerate(curves.items()):
        for split, curve in splits.items():
            is_training = split == "train"
            style = {"alpha": 0.4, "linewidth": 1} if is_training else {"marker": ".", "linewidth": 1.5}
            panel.plot(*curve, color=f"C{number % 10}", label=_plain(f"{run}, {split}"), **style)
    panel.set_xlabel("update")
    panel.set_ylabel(_plain(metric))
    panel.grid(alpha=0.3)
    panel.legend(fontsize="small")
    return figure


def save_chart(path: Path, figure: "Figure") -> None:
    """Writes a figure in the format of the file's suffix."""
    with atomic_file(path) as partial:
        figure.savefig(partial, format=path.suffix[1:], dpi=DPI)


def _figure(width: float, height: float) -> "Figure":
    # Without pyplot, which looks for a display and keeps what it drew.
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _plain(text: str) -> str:
    """Returns text in which matplotlib sees no formulas."""
    return text.replace("$", r"\$")
