"""Plots of a report as inline SVG, whose colors are those of the page."""

import html
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int, Num

WIDTH = 400
HEIGHT = 160
BOTTOM = 20
"""Room for the text below a plot."""
NUM_BINS = 28
"""Steps of the histogram of lengths."""


def lengths_plot(lengths: Mapping[str, Int[np.ndarray, " _"]], *, fps: float) -> str:
    """Returns histograms of the lengths (frames) of motions of each kind."""
    longest = max(int(frames.max()) for frames in lengths.values())
    edges = np.linspace(0, longest + 1, NUM_BINS + 1)
    shares = {kind: np.histogram(frames, edges)[0] / len(frames) for kind, frames in lengths.items()}
    return _plot(shares, "0", f"{longest / fps:.1f} s")


def codes_plot(counts: Mapping[str, Int[np.ndarray, " K"]]) -> str:
    """Returns how often motions of each kind use each code; codes that the first kind uses most come first."""
    order = np.argsort(-next(iter(counts.values())), kind="stable")
    shares = {kind: used[order] / max(used.sum(), 1) for kind, used in counts.items()}
    return _plot(shares, "codes, most used by real motion first", "")


def _plot(shares: Mapping[str, Num[np.ndarray, " _"]], left: str, right: str) -> str:
    """Returns a stepped line for each kind, below the largest share and above texts for both ends."""
    top = max(float(values.max()) for values in shares.values())
    parts = [_label(0, 12, f"{100 * top:.1f} %"), _label(0, HEIGHT, left), _label(WIDTH, HEIGHT, right, anchor="end")]
    for number, (kind, values) in enumerate(shares.items()):
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in _steps(values / (top or 1)))
        parts.append(f'<polyline points="{points}" fill="none" stroke="var(--{kind})" stroke-width="1.5"/>')
        parts.append(_label(WIDTH, 12 + 16 * number, kind, anchor="end", color=kind))
    return f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" font-size="12" aria-hidden="true">{"".join(parts)}</svg>'


def _steps(values: Float[np.ndarray, " N"]) -> Float[np.ndarray, "M 2"]:
    """Returns the corners of a line that has a step for each value from 0 to 1."""
    x = np.repeat(np.linspace(0, WIDTH, len(values) + 1), 2)[1:-1]
    return np.stack([x, (HEIGHT - BOTTOM) - (HEIGHT - 2 * BOTTOM) * np.repeat(values, 2)], axis=1)


def _label(x: float, y: float, text: str, *, anchor: str = "start", color: str = "faint") -> str:
    return f'<text x="{x}" y="{y}" text-anchor="{anchor}" fill="var(--{color})">{html.escape(text)}</text>'
