"""Plots of a report as inline SVG: text stays text, and the colours are those of the page they stand on."""

import contextlib
import io
import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from t2m_jax.errors import UserError
from t2m_jax.evaluation.report.formats import heading
from t2m_jax.evaluation.report.tables import Column

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INKS = {"text": "#010101", "faint": "#020202", "real": "#030303", "generated": "#040404", "reconstruction": "#050505"}
"""Stand in for the page's colours while matplotlib draws, since it knows no CSS variables."""
ROWS = {"real": "real motion"}
"""What rows of a report are called, where it is not their name there."""
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "font.size": 9,
    "text.color": INKS["text"],
    "axes.labelcolor": INKS["text"],
    "axes.titlesize": 9,
    "axes.edgecolor": INKS["faint"],
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.axisbelow": True,
    "grid.color": INKS["faint"],
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "xtick.color": INKS["faint"],
    "ytick.color": INKS["faint"],
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "legend.frameon": False,
    "lines.linewidth": 1.4,
}
LENGTH_BINS = 28
"""Most bars in the histogram of lengths."""
FRAMES_A_BIN = 4
"""Lengths are multiples of it, so bars are as wide as a multiple of it."""


def check_plots() -> None:
    """Raises `UserError` where plots cannot be drawn because matplotlib is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise UserError("matplotlib is missing, which draws the plots; pip install 't2m-jax[report]'") from None


@contextlib.contextmanager
def _drawing(name: str) -> Iterator[None]:
    """Draws with the style above whatever the user has configured; `name` keeps the ids of two plots apart."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE | {"svg.hashsalt": name})
        yield


def _svg(figure: "Figure") -> str:
    """Returns the drawing as an element for an HTML page, the same bytes for the same drawing."""
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    svg = file.getvalue()
    svg = svg[svg.index("<svg") :].rstrip()
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    # Groups are named alike in every plot, and the element takes its width from the page.
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    opening, rest = svg.split(">", 1)
    opening = re.sub(r' (?:xmlns(?::\w+)?|width|height|version)="[^"]*"', "", opening)
    for ink, colour in INKS.items():
        rest = rest.replace(colour, f"var(--{ink})")
    return f'{opening} aria-hidden="true">{rest}'


def _figure(width: float, height: float) -> "Figure":
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def repeats_plot(rows: Mapping[str, Any], columns: tuple[Column, ...]) -> str:
    """Returns each metric against the repeat, with mean and 95 % interval as a band, for real and measured motion.

    Args:
        rows: The report's: row -> metric -> `mean`, `interval`, `repeats`.
        columns: Metrics to show.
    """
    across = 4
    down = -(-(len(columns) + 1) // across)
    with _drawing("repeats"):
        figure = _figure(9.6, 2.05 * down)
        axes = figure.subplots(down, across, squeeze=False).ravel()
        for axis, column in zip(axes, columns, strict=False):
            for row, figures in rows.items():
                if column.metric in figures:
                    _draw_repeats(axis, figures[column.metric], ink=INKS[row])
            axis.set_title(heading(column), loc="left")
            axis.xaxis.get_major_locator().set_params(integer=True)
        for axis in axes[len(columns) :]:
            axis.set_axis_off()
        handles = [axes[-1].plot([], [], "o-", markersize=3, color=INKS[row])[0] for row in rows]
        axes[-1].legend(handles, [ROWS.get(row, row) for row in rows], loc="center left", fontsize=9)
        figure.supxlabel("repeat", fontsize=9)
        return _svg(figure)


def _draw_repeats(axis: "Axes", found: Mapping[str, Any], *, ink: str) -> None:
    values = np.asarray(found["repeats"], np.float64)
    numbers = np.arange(1, len(values) + 1)
    edges = [numbers[0] - 0.4, numbers[-1] + 0.4]
    low, high = found["mean"] - found["interval"], found["mean"] + found["interval"]
    axis.fill_between(edges, [low, low], [high, high], color=ink, alpha=0.18, linewidth=0)
    axis.plot(edges, [found["mean"]] * 2, color=ink, alpha=0.7, linewidth=0.9)
    axis.plot(numbers, values, "o-", color=ink, markersize=3, linewidth=0.9)


def lengths_plot(real: Int[np.ndarray, " N"], made: Int[np.ndarray, " N"], *, fps: float, row: str) -> str:
    """Returns how long real motions and those of a row of the report are (frames), as shares of all."""
    longest = max(real.max(), made.max())
    width = -(-int(longest) // (FRAMES_A_BIN * LENGTH_BINS)) * FRAMES_A_BIN
    edges = np.arange(0, longest + 2 * width, width) - FRAMES_A_BIN / 2
    with _drawing("lengths"):
        figure = _figure(4.7, 2.7)
        axis = figure.subplots()
        shares = [100 * np.histogram(lengths, edges)[0] / len(lengths) for lengths in (real, made)]
        axis.stairs(shares[0], edges / fps, color=INKS["real"], fill=True, alpha=0.35, label="real motion")
        axis.stairs(shares[1], edges / fps, color=INKS[row], linewidth=1.6, label=row)
        axis.set_xlim(0, None)
        axis.set_xlabel("length, seconds")
        axis.set_ylabel("motions, %")
        axis.legend(loc="best", fontsize=8)
        return _svg(figure)


def codes_plot(real: Int[np.ndarray, " K"], made: Int[np.ndarray, " K"], *, row: str) -> str:
    """Returns how often each code is used by real motion and by a row of the report, most used by real motion first.

    Codes that the row never uses are points on the lower edge.
    """
    order = np.argsort(-real, kind="stable")
    shares: list[Float[np.ndarray, " K"]] = [100 * counts[order] / max(counts.sum(), 1) for counts in (real, made)]
    used = np.concatenate([share[share > 0] for share in shares])
    floor = (used.min() if len(used) else 1.0) / 2
    edges = np.arange(len(order) + 1) + 0.5
    with _drawing("codes"):
        figure = _figure(4.7, 2.7)
        axis = figure.subplots()
        axis.stairs(
            np.maximum(shares[0], floor), edges, baseline=floor, color=INKS["real"], fill=True, alpha=0.35,
            label="real motion",
        )  # fmt: skip
        axis.plot(
            np.arange(1, len(order) + 1), np.maximum(shares[1], floor), ".", color=INKS[row], markersize=2.5,
            label=row,
        )  # fmt: skip
        axis.set_yscale("log")
        axis.yaxis.set_major_formatter("{x:g}")
        axis.set_ylim(floor * 0.85, None)
        axis.set_xlim(edges[0], edges[-1])
        axis.set_xlabel("codes, most used by real motion first")
        axis.set_ylabel("use, %")
        axis.legend(loc="upper right", fontsize=8)
        return _svg(figure)
