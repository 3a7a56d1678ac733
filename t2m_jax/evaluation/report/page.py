"""A report as one HTML file that loads nothing else: table, plots, and motions to look at."""

import html
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from t2m_jax.evaluation.report.formats import MISSING, heading, interval_text, mean_text, repeats_text, table_grid
from t2m_jax.evaluation.report.gallery import Example, RepeatDetails
from t2m_jax.evaluation.report.plots import codes_plot, lengths_plot
from t2m_jax.evaluation.report.record import Report, report_as_json
from t2m_jax.evaluation.report.tables import Cell, Table, make_table
from t2m_jax.files.template import fill_template
from t2m_jax.files.writing import save_text
from t2m_jax.metrics.codes import code_usage, perplexity
from t2m_jax.motion.motion import Motion

Viewer = Callable[[Sequence[Motion]], str]
"""Returns an HTML page that plays motions, side by side if there are several."""


def save_page(path: Path, report: Report, details: RepeatDetails, *, viewer: Viewer) -> None:
    """Writes the page."""
    save_text(path, report_page(report, details, viewer=viewer))


def report_page(report: Report, details: RepeatDetails, *, viewer: Viewer) -> str:
    """Returns the page; it is the same text for the same report and details.

    Args:
        report: The metrics.
        details: The report's first repeat.
        viewer: Plays the motions. Its pages are shown in frames that may run scripts and nothing else.
    """
    stages = _Stages(viewer)
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
        "table_note": _text(f"{repeats_text(table)}."),
        "quality": _table(make_table([report], [report.kind], measures="quality")),
        **_detail_plots(details),
        "retrieval_note": _text(
            f"Each caption ranks the {report.header.batch} motions of its batch by distance. Of {count} captions, "
            f"{first:.1f} % find their own motion nearest; the median rank is {np.median(details.ranks):g}. "
            f"{len(details.examples)} captions, drawn by the seed. Left: {report.kind}; right: the real motion. "
            "Distances are in the evaluator's space."
        ),
        "failures_note": _text(
            f"Captions whose own motion has the worst rank in its batch of {report.header.batch}; if ranks are equal, "
            "the farthest first."
        ),
        "examples": "\n".join(_card(example, details, stages) for example in details.examples),
        "failures": "\n".join(_card(example, details, stages) for example in details.failures),
        "pages": stages.pages_json(),
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


class _Stages:
    """The places of viewers. The page of a viewer is loaded when its place is near the visible part of the page."""

    def __init__(self, viewer: Viewer):
        self.viewer = viewer
        self.pages: list[str] = []

    def add(self, motions: Sequence[Motion], label: str) -> str:
        """Returns the element of a viewer."""
        self.pages.append(self.viewer(motions))
        return f'<div class="stage" role="group" aria-label="{_text(label)}" data-page="{len(self.pages) - 1}"></div>'

    def pages_json(self) -> str:
        """Returns the middle of each page and, because viewers are large, what all begin and end with only once."""
        head = os.path.commonprefix(self.pages)  # noqa: RUF071 - texts, not paths
        rests = [page[len(head) :] for page in self.pages]
        tail = os.path.commonprefix([rest[::-1] for rest in rests])[::-1]  # noqa: RUF071
        data = {"head": head, "tail": tail, "middles": [rest[: len(rest) - len(tail)] for rest in rests]}
        return json.dumps(data).replace("<", "\\u003c")  # in a script element only `<` can do harm


def _card(example: Example, details: RepeatDetails, stages: _Stages) -> str:
    """Returns a caption with its motions."""
    skeleton = details.skeleton
    # Viewers write the caption below a motion.
    pairs = ((example.measured, details.kind), (example.real, "real"))
    motions = [Motion(positions, skeleton.fps, skeleton=skeleton, caption=kind) for positions, kind in pairs]
    return (
        f'<article class="card"><h3>{_text(example.caption)}</h3>'
        f'<div class="note">rank {example.rank}, distance {example.distance:.2f}; '
        f"the real motion's distance is {example.real_distance:.2f}</div>"
        f"{stages.add(motions, f'Motion, {details.kind} and real, of: {example.caption}')}</article>"
    )
