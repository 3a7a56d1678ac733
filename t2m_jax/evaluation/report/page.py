"""A report as one HTML file that loads nothing else: table, plots, and motions to look at."""

import html
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Num

from t2m_jax.evaluation.report.formats import MISSING, facts_text, heading, interval_text, mean_text, table_grid
from t2m_jax.evaluation.report.gallery import Example, RepeatDetails
from t2m_jax.evaluation.report.record import Report, report_as_json
from t2m_jax.evaluation.report.tables import Cell, Table, make_table
from t2m_jax.files.template import fill_template
from t2m_jax.files.writing import save_text
from t2m_jax.metrics.codes import code_usage, perplexity
from t2m_jax.motion.motion import Motion

Viewer = Callable[[Sequence[Motion]], str]
"""Returns an HTML element that plays motions, side by side if there are several."""
WIDTH = 400
HEIGHT = 160
BOTTOM = 20
"""Room for the text below a plot."""
NUM_BINS = 28
"""Steps of the histogram of lengths."""


def save_page(path: str | Path, report: Report, details: RepeatDetails, *, viewer: Viewer) -> None:
    """Writes the page."""
    save_text(path, report_page(report, details, viewer=viewer))


def report_page(report: Report, details: RepeatDetails, *, viewer: Viewer) -> str:
    """Returns the page; it is the same text for the same report and details.

    Args:
        report: The metrics.
        details: The report's first repeat.
        viewer: Plays the motions.
    """
    table = make_table([report], [report.kind])
    facts = (
        f"<div><dt>{_text(name.replace('_', ' '))}</dt><dd>{_text(value)}</dd></div>"
        for name, value in report_as_json(report).items()
        # The dictionaries are what tables and plots show.
        if not isinstance(value, dict) and value not in (None, "")
    )
    first = 100 * float(np.mean(details.ranks == 1))
    count = len(details.ranks)
    parts = {
        "title": _text(f"Evaluation of {report.header.model}" if report.header.model else "Evaluation"),
        "facts": "".join(facts),
        "table": _table(table),
        "table_note": _text(facts_text(table._replace(facts={}))),
        "quality": _table(make_table([report], [report.kind], measures="quality")),
        **_detail_plots(details),
        "retrieval_note": _text(
            f"Each caption ranks the {report.header.batch} motions of its batch by distance. Of {count} captions, "
            f"{first:.1f} % find their own motion nearest; the median rank is {np.median(details.ranks):g}. "
            f"{len(details.examples)} captions, drawn by the seed, with their own motion and the real one. "
            "Distances are in the evaluator's space."
        ),
        "failures_note": _text(
            f"Captions whose own motion has the worst rank in its batch of {report.header.batch}; if ranks are equal, "
            "the farthest first."
        ),
        "examples": _motions(details.examples, details, viewer),
        "failures": _motions(details.failures, details, viewer),
    }
    return fill_template("t2m_jax.evaluation.report", "assets/report.html", parts)


def _text(text: object) -> str:
    """Returns text that HTML shows as it is."""
    return html.escape(f"{text:.3f}" if isinstance(text, float) else str(text))


def _table(table: Table) -> str:
    def figure(cell: Cell | None) -> str:
        if cell is None:
            return MISSING
        interval = interval_text(cell)
        return f"{mean_text(cell)} <small>± {interval}</small>" if interval else mean_text(cell)

    headings = "".join(f'<th scope="col">{_text(heading(column))}</th>' for column in table.columns)
    lines = "\n".join(
        f'<tr><th scope="row">{name}</th>{"".join(f"<td>{text}</td>" for text in texts)}</tr>'
        for name, *texts in table_grid(table, _text, figure)
    )
    return f"<table>\n<thead><tr><th></th>{headings}</tr></thead>\n<tbody>\n{lines}\n</tbody>\n</table>"


def _plot(svg: str, label: str, caption: str) -> str:
    return (
        f'<figure class="card"><div class="plot wide" role="img" aria-label="{_text(label)}">{svg}</div>'
        f"<figcaption>{_text(caption)}</figcaption></figure>"
    )


def _detail_plots(details: RepeatDetails) -> dict[str, str]:
    """Returns the plots of lengths and codes by their places in the page."""

    def used(counts: Int[np.ndarray, " K"]) -> str:
        known = jnp.asarray(counts, jnp.int32)
        return f"{100 * float(code_usage(known)):.1f} % of the codes, perplexity {float(perplexity(known)):.1f}"

    kind = details.kind
    frames = {"real": details.real_lengths, kind: details.measured_lengths}
    counts = {"real": details.real_code_counts, kind: details.measured_code_counts}
    means = [lengths.mean() / details.skeleton.fps for lengths in frames.values()]
    lengths = _plot(
        lengths_plot(frames, fps=details.skeleton.fps),
        f"Lengths of real motion and of {kind}",
        f"Mean length: real motion {means[0]:.2f} s, {kind} {means[1]:.2f} s.",
    )
    codes = _plot(
        codes_plot(counts),
        f"Use of the codebook by real motion and by {kind}",
        f"Codebook of {len(counts[kind])}: real motion, encoded, uses {used(counts['real'])}; {kind} uses "
        f"{used(counts[kind])}.",
    )
    return {"lengths_plot": lengths, "codes_plot": codes}


def _motions(examples: Sequence[Example], details: RepeatDetails, viewer: Viewer) -> str:
    """Returns a viewer of all examples, and below it a line for each."""
    motions = []
    lines = []
    for number, example in enumerate(examples, start=1):
        # Viewers write the caption below a motion.
        for positions, kind in ((example.measured, details.kind), (example.real, "real")):
            caption = f"{number}, {kind}: {example.caption}"
            motions.append(Motion(positions, details.skeleton.fps, skeleton=details.skeleton, caption=caption))
        lines.append(
            f"<li>{_text(example.caption)}: rank {example.rank}, distance {example.distance:.2f}; the real motion's "
            f"distance is {example.real_distance:.2f}</li>"
        )
    return f"{viewer(motions)}<ol>{''.join(lines)}</ol>"


def lengths_plot(lengths: Mapping[str, Int[np.ndarray, " _"]], *, fps: float) -> str:
    """Returns histograms of the lengths (frames) of motions of each kind."""
    longest = max(int(frames.max()) for frames in lengths.values())
    edges = np.linspace(0, longest + 1, NUM_BINS + 1)
    shares = {kind: np.histogram(frames, edges)[0] / len(frames) for kind, frames in lengths.items()}
    return _lines(shares, "0", f"{longest / fps:.1f} s")


def codes_plot(counts: Mapping[str, Int[np.ndarray, " K"]]) -> str:
    """Returns how often motions of each kind use each code; codes that the first kind uses most come first."""
    order = np.argsort(-next(iter(counts.values())), kind="stable")
    shares = {kind: used[order] / max(used.sum(), 1) for kind, used in counts.items()}
    return _lines(shares, "codes, most used by real motion first", "")


def _lines(shares: Mapping[str, Num[np.ndarray, " _"]], left: str, right: str) -> str:
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
