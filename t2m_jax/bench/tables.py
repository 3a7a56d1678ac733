"""Reports as Markdown tables, whose columns are aligned so that they can also be read in a terminal."""

from collections.abc import Sequence

from t2m_jax.bench.record import BenchReport, Figure
from t2m_jax.files.markdown import markdown_table

MISSING = "-"
"""Printed if a row has no such figure."""
TITLES = {"train": "Training", "sample": "Sampling", "evaluate": "Evaluation", "data": "Data"}


def fitted_table(headings: Sequence[str], rows: Sequence[Sequence[str]], *, width: int | None = None) -> str:
    """Returns an aligned Markdown table.

    If it is wider than `width` characters, columns and rows are exchanged, which is narrower for a few rows.
    """
    text = markdown_table(headings, rows, aligned=True)
    if width is None or len(text.partition("\n")[0]) <= width:
        return text
    headings, *rows = zip(headings, *rows, strict=True)
    return markdown_table(headings, rows, aligned=True)


def report_text(report: BenchReport, *, width: int | None = None) -> str:
    """Returns a report as text: a line on the machine, its peaks, and one table for each benchmark."""
    machine = report.machine
    devices = f"{machine.num_devices} x {machine.device_kind}"
    parts = [f"{machine.processor}, {machine.num_cores} cores; {devices}; JAX {machine.jax_version}; {report.date}."]
    headings = ["measured peak on", "float32 (GFLOP/s)", "bfloat16 (GFLOP/s)", "memory (GB/s)"]
    cells = []
    for peak in machine.peaks:
        rates = (peak.float32, peak.bfloat16, peak.memory)
        cells.append([f"{peak.num_devices} device(s)", *(f"{rate / 1e9:,.1f}" for rate in rates)])
    parts.append(fitted_table(headings, cells, width=width))
    for benchmark, title in TITLES.items():
        rows = [row for row in report.rows if row.benchmark == benchmark]
        # Rows that do not have the same figures share a table; cells that are missing are marked.
        headings = list(dict.fromkeys(figure.heading for row in rows for figure in row.figures))
        cells = []
        for row in rows:
            found = {figure.heading: number_text(figure) for figure in row.figures}
            cells.append([row.name, *(found.get(heading, MISSING) for heading in headings)])
        if rows:
            parts += [f"## {title}", fitted_table([benchmark, *headings], cells, width=width)]
    if report.peak_memory is not None:
        parts.append(f"Peak memory of the whole command: {report.peak_memory / 1e9:.2f} GB.")
    return "\n\n".join(parts)


def number_text(figure: Figure) -> str:
    """Returns a value with three digits, or with all digits before the point; without a unit, with six digits."""
    if not figure.unit:
        return f"{figure.value:.6g}"
    return f"{figure.value:,.0f}" if abs(figure.value) >= 1000 else f"{figure.value:.3g}"
