"""A report as one HTML file that loads nothing else: table, plots, and motions to look at."""

import html
from collections.abc import Callable, Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from t2m_jax.evaluation.report.formats import MISSING, facts_text, heading, interval_text, mean_text, table_grid
from t2m_jax.evaluation.report.gallery import Example, RepeatDetails
from t2m_jax.evaluation.report.plots import codes_plot, lengths_plot
from t2m_jax.evaluation.report.record import Report, report_as_json
from t2m_jax.evaluation.report.tables import Cell, Table, make_table
from t2m_jax.files.template import fill_template
from t2m_jax.files.writing import save_text
from t2m_jax.metrics.codes import code_usage, perplexity
from t2m_jax.motion.motion import Motion

Viewer = Callable[[Sequence[Motion]], str]
"""Returns an HTML element that plays motions, side by side if there are several."""


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
        return f"{mean_text(cell)} <small>± {interval_text(cell)}</small>"

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
