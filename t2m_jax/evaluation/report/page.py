"""A report as one HTML file that fetches nothing: table, plots, and motions to look at."""

import dataclasses
import html
import importlib.resources
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from t2m_jax.evaluation.protocols import BATCH
from t2m_jax.evaluation.report.details import Evidence
from t2m_jax.evaluation.report.formats import MISSING, heading, interval_text, mean_text, repeats_text
from t2m_jax.evaluation.report.gallery import Example, Failure
from t2m_jax.evaluation.report.plots import check_plots, codes_plot, lengths_plot, repeats_plot
from t2m_jax.evaluation.report.record import check_output, save_text
from t2m_jax.evaluation.report.tables import Cell, Table, make_table
from t2m_jax.metrics.codes import code_usage, perplexity
from t2m_jax.motion.record import Motion

Viewer = Callable[[Sequence[Motion]], str]
"""Motions to the HTML page that plays them, side by side if several."""


def check_page(path: Path) -> None:
    """Raises `UserError` where the page could not be made, before the work is done."""
    check_plots()
    check_output(path)


def save_page(path: Path, report: Mapping[str, Any], evidence: Evidence, *, viewer: Viewer) -> None:
    """Writes the page; the file appears whole or not at all."""
    save_text(path, report_page(report, evidence, viewer=viewer))


def report_page(report: Mapping[str, Any], evidence: Evidence, *, viewer: Viewer) -> str:
    """Returns the page: the same text for the same report and evidence.

    Args:
        report: As `t2m evaluate generation --json` writes it.
        evidence: Of the report's first repeat.
        viewer: Draws the motions. The pages it returns are shown in frames that run scripts and nothing else.
    """
    table = make_table([report], [evidence.row])
    parts = {
        "title": _text(f"Evaluation of {report['model']}" if "model" in report else "Evaluation"),
        "facts": _facts(report),
        "table": _table(table),
        "table_note": _text(f"{repeats_text(table)}."),
        "repeats_plot": _plot(repeats_plot(report["rows"], table.columns), "Metrics of each repeat", "", "broad"),
        "lengths_plot": _lengths(evidence),
        "codes_plot": _codes(evidence),
        "retrieval_note": _retrieval_note(evidence),
        "examples": "\n".join(_example(example, viewer) for example in evidence.examples),
        "failures_note": _text(
            f"Captions whose own motion is ranked worst among the {BATCH} of its batch, among equals the farthest "
            f"first; on the left {evidence.row}, on the right the real motion. Distances are those of the evaluator."
        ),
        "failures": "\n".join(_failure(failure, evidence.row, viewer) for failure in evidence.failures),
    }
    template = (importlib.resources.files("t2m_jax.evaluation.report") / "assets" / "report.html").read_text(
        encoding="utf-8"
    )
    # In one go: what a part holds is not looked at again, whatever it looks like.
    return re.sub(r"\{\{(\w+)\}\}", lambda place: parts[place[1]], template)


def _text(text: object) -> str:
    return html.escape(str(text))


def _facts(report: Mapping[str, Any]) -> str:
    """Returns all that the report says of itself."""
    facts = {name: value for name, value in report.items() if name != "rows" and value is not None}
    texts = {name: f"{value:.3f}" if isinstance(value, float) else value for name, value in facts.items()}
    return "".join(
        f"<div><dt>{_text(name.replace('_', ' '))}</dt><dd>{_text(text)}</dd></div>" for name, text in texts.items()
    )


def _table(table: Table) -> str:
    def figure(cell: Cell | None) -> str:
        if cell is None:
            return f"<td>{MISSING}</td>"
        mean = f"<b>{mean_text(cell)}</b>" if cell.best else mean_text(cell)
        return f"<td>{mean} <small>± {interval_text(cell)}</small></td>"

    headings = "".join(f'<th scope="col">{_text(heading(column))}</th>' for column in table.columns)
    rows = "\n".join(
        f'<tr><th scope="row">{_text(row.name)}</th>'
        + "".join(figure(row.cells.get(column.metric)) for column in table.columns)
        + "</tr>"
        for row in table.rows
    )
    return f"<table>\n<thead><tr><th></th>{headings}</tr></thead>\n<tbody>\n{rows}\n</tbody>\n</table>"


def _plot(svg: str, label: str, caption: str, kind: str = "") -> str:
    caption = f"<figcaption>{_text(caption)}</figcaption>" if caption else ""
    return (
        f'<figure class="card"><div class="plot wide {kind}" role="img" aria-label="{_text(label)}">{svg}</div>'
        f"{caption}</figure>"
    )


def _lengths(evidence: Evidence) -> str:
    means = [lengths.mean() / evidence.fps for lengths in (evidence.real_lengths, evidence.made_lengths)]
    return _plot(
        lengths_plot(evidence.real_lengths, evidence.made_lengths, fps=evidence.fps, row=evidence.row),
        f"Lengths of real motion and of {evidence.row}",
        f"Length: real motion {means[0]:.2f} s in the mean, {evidence.row} {means[1]:.2f} s.",
    )


def _codes(evidence: Evidence) -> str:
    def used(counts: Int[np.ndarray, " K"]) -> str:
        known = jnp.asarray(counts, jnp.int32)
        return f"{100 * float(code_usage(known)):.1f} % of the codes, perplexity {float(perplexity(known)):.1f}"

    real, made = evidence.real_code_counts, evidence.made_code_counts
    return _plot(
        codes_plot(real, made, row=evidence.row),
        f"Use of the codebook by real motion and by {evidence.row}",
        f"Codebook of {len(real)}: real motion, encoded, uses {used(real)}; {evidence.row} uses {used(made)}. "
        "Points on the lower edge are codes it never uses.",
    )


def _retrieval_note(evidence: Evidence) -> str:
    first = 100 * float(np.mean(evidence.ranks == 1))
    return _text(
        f"Each caption ranks the {BATCH} motions of its batch by distance. Of {len(evidence.ranks)} captions "
        f"{first:.1f} % find their own motion nearest; its median rank is {np.median(evidence.ranks):g}. "
        f"{len(evidence.examples)} captions, drawn by the seed, with the motions nearest to them from left to right:"
    )


def _stage(motions: Sequence[Motion], labels: Sequence[str], label: str, viewer: Viewer) -> str:
    """Returns the place of a viewer, with the page that is shown once it is near the screen."""
    named = [dataclasses.replace(motion, caption=name) for motion, name in zip(motions, labels, strict=True)]
    return f'<div class="stage" role="group" aria-label="{_text(label)}" data-page="{_text(viewer(named))}"></div>'


def _example(example: Example, viewer: Viewer) -> str:
    motions = [candidate.motion for candidate in example.nearest]
    labels = [
        f"{number}, its own" if candidate.own else f"{number}"
        for number, candidate in enumerate(example.nearest, start=1)
    ]
    own_mark = ' <span class="own">its own</span>'
    items = "".join(
        f"<li>{number}. {_text(candidate.motion.caption)} "
        f'<span class="note">{candidate.distance:.2f}</span>{own_mark if candidate.own else ""}</li>'
        for number, candidate in enumerate(example.nearest, start=1)
    )
    return (
        f'<article class="card"><h3>{_text(example.caption)}</h3>'
        f'<div class="note">own motion: rank {example.rank}, distance {example.distance:.2f}</div>'
        f"{_stage(motions, labels, f'Motions nearest to: {example.caption}', viewer)}<ol>{items}</ol></article>"
    )


def _failure(failure: Failure, row: str, viewer: Viewer) -> str:
    stage = _stage(
        [failure.made, failure.real],
        [row, "real"],
        f"Motion, {row} and real, of: {failure.caption}",
        viewer,
    )
    return (
        f'<article class="card"><h3>{_text(failure.caption)}</h3>'
        f'<div class="note">rank {failure.rank}, distance {failure.distance:.2f}; '
        f"the real motion's distance is {failure.real_distance:.2f}</div>{stage}</article>"
    )
