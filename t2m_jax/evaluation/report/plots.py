"""Plots of a report as inline SVG: text stays text, and the colors are those of the page."""

import contextlib
import io
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from t2m_jax.errors import UserError
from t2m_jax.evaluation.report.formats import heading
from t2m_jax.evaluation.report.record import REAL, Report
from t2m_jax.evaluation.report.tables import Column

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INKS = {"text": "#010101", "faint": "#020202", "real": "#030303", "generated": "#040404", "reconstruction": "#050505"}
"""Placeholders of the page's colors while matplotlib draws, because it does not know CSS variables."""
STYLE: dict[Any, Any] = {
    # Text and not outlines, so that it can be searched and has the font of the page.
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
"""Largest number of bars in the histogram of lengths."""
FRAMES_PER_BIN = 4
"""Bars are as wide as a multiple of this: the lengths of most evaluations are multiples of it."""


def check_plots() -> None:
    """Raises `UserError` if matplotlib is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise UserError("matplotlib is missing, but the page needs plots; pip install 't2m-jax[report]'") from None


@contextlib.contextmanager
def _drawing(name: str, width: float, height: float) -> Iterator["Figure"]:
    """Yields an empty figure of a size in inches; what is drawn on it in the block has the style above.

    The style does not depend on what the user has configured. `name` keeps the ids of two plots apart.
    """
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE | {"svg.hashsalt": name})
        yield Figure(figsize=(width, height), layout="constrained")


def _svg(figure: "Figure") -> str:
    """Returns the drawing as an HTML element; it is the same text for the same drawing."""
    file = io.StringIO()
    # Without the date, the same report gives the same file.
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    svg = file.getvalue()
    svg = svg[svg.index("<svg") :].rstrip()
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    # Every plot has groups of the same ids, which must be unique in a page; the page sets the width.
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    opening, rest = svg.split(">", 1)
    opening = re.sub(r' (?:xmlns(?::\w+)?|width|height|version)="[^"]*"', "", opening)
    for ink, color in INKS.items():
        rest = rest.replace(color, f"var(--{ink})")
    return f'{opening} aria-hidden="true">{rest}'


def repeats_plot(report: Report, columns: tuple[Column, ...]) -> str:
    """Returns the values of each repeat for real and measured motion; bands are mean and 95 % interval."""
    across = 4
    down = -(-(len(columns) + 1) // across)  # one more for the legend
    with _drawing("repeats", 9.6, 2.05 * down) as figure:
        axes = figure.subplots(down, across, squeeze=False).ravel()
        for axis, column in zip(axes, columns, strict=False):
            for kind, metrics in report.metrics.items():
                if column.metric not in metrics:
                    continue
                found = metrics[column.metric]
                ink = INKS[kind]
                low = found.mean - found.interval
                high = found.mean + found.interval
                numbers = np.arange(1, len(found.repeats) + 1)
                edges = [0.6, len(numbers) + 0.4]
                axis.fill_between(edges, [low, low], [high, high], color=ink, alpha=0.18, linewidth=0)
                axis.plot(edges, [found.mean] * 2, color=ink, alpha=0.7, linewidth=0.9)
                axis.plot(numbers, found.repeats, "o-", color=ink, markersize=3, linewidth=0.9)
            axis.set_title(heading(column), loc="left")
            axis.xaxis.get_major_locator().set_params(integer=True)
        for axis in axes[len(columns) :]:
            axis.set_axis_off()
        handles = [axes[-1].plot([], [], "o-", markersize=3, color=INKS[kind])[0] for kind in report.metrics]
        names = ["real motion" if kind == REAL else kind for kind in report.metrics]
        axes[-1].legend(handles, names, loc="center left", fontsize=9)
        figure.supxlabel("repeat", fontsize=9)
        return _svg(figure)


def lengths_plot(real: Int[np.ndarray, " N"], measured: Int[np.ndarray, " N"], *, fps: float, kind: str) -> str:
    """Returns a histogram of the lengths (frames) of real and measured motions."""
    longest = max(real.max(), measured.max())
    width = -(-int(longest) // (FRAMES_PER_BIN * LENGTH_BINS)) * FRAMES_PER_BIN
    # Shifted by half a width, so that the common lengths are inside of bars and not at their edges.
    edges = np.arange(0, longest + 2 * width, width) - FRAMES_PER_BIN / 2
    with _drawing("lengths", 4.7, 2.7) as figure:
        axis = figure.subplots()
        shares = [100 * np.histogram(lengths, edges)[0] / len(lengths) for lengths in (real, measured)]
        axis.stairs(shares[0], edges / fps, color=INKS["real"], fill=True, alpha=0.35, label="real motion")
        axis.stairs(shares[1], edges / fps, color=INKS[kind], linewidth=1.6, label=kind)
        axis.set_xlim(0, None)
        axis.set_xlabel("length, seconds")
        axis.set_ylabel("motions, %")
        axis.legend(loc="best", fontsize=8)
        return _svg(figure)


def codes_plot(real: Int[np.ndarray, " K"], measured: Int[np.ndarray, " K"], *, kind: str) -> str:
    """Returns how often real and measured motions use each code; codes that real motion uses most come first.

    Codes that the measured motions never use are points on the lower edge.
    """
    order = np.argsort(-real, kind="stable")
    shares: list[Float[np.ndarray, " K"]] = [100 * counts[order] / max(counts.sum(), 1) for counts in (real, measured)]
    used = np.concatenate([share[share > 0] for share in shares])
    # A logarithmic axis has no place for zero.
    floor = (used.min() if len(used) else 1.0) / 2
    edges = np.arange(len(order) + 1) + 0.5
    with _drawing("codes", 4.7, 2.7) as figure:
        axis = figure.subplots()
        axis.stairs(
            np.maximum(shares[0], floor), edges, baseline=floor, color=INKS["real"], fill=True, alpha=0.35,
            label="real motion",
        )  # fmt: skip
        axis.plot(
            np.arange(1, len(order) + 1), np.maximum(shares[1], floor), ".", color=INKS[kind], markersize=2.5,
            label=kind,
        )  # fmt: skip
        axis.set_yscale("log")
        axis.yaxis.set_major_formatter("{x:g}")
        axis.set_ylim(floor * 0.85, None)
        axis.set_xlim(edges[0], edges[-1])
        axis.set_xlabel("codes, most used by real motion first")
        axis.set_ylabel("use, %")
        axis.legend(loc="upper right", fontsize=8)
        return _svg(figure)
