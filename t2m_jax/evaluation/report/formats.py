"""Tables as text for the terminal, Markdown, LaTeX and JSON: mean and 95 % interval, arrows, the best in bold."""

import json
import re
from typing import Literal

from t2m_jax.errors import printable
from t2m_jax.evaluation.report.tables import DIGITS, Cell, Column, Table
from t2m_jax.files.markdown import markdown_table

MISSING = "-"
"""Printed if a row has no such figure."""
ARROWS = {"higher": " ↑", "lower": " ↓", "real": " →", "none": ""}


def heading(column: Column) -> str:
    """Returns a column's heading with its arrow."""
    return f"{column.heading}{ARROWS[column.better]}"


def mean_text(cell: Cell) -> str:
    """Returns the mean as it is printed."""
    return f"{cell.mean:.{DIGITS}f}"


def interval_text(cell: Cell) -> str:
    """Returns the half-width as papers print it: `.003`, without the zero before the point."""
    return f"{cell.interval:.{DIGITS}f}".removeprefix("0")


def repeats_text(table: Table) -> str:
    """Returns what the figures of a table are: mean and interval over how many repeats."""
    counts = sorted({row.num_repeats for row in table.rows})
    repeats = "1 repeat" if counts == [1] else " to ".join(map(str, [*counts[:1], *counts[1:][-1:]])) + " repeats"
    return f"Mean and 95 % interval over {repeats}"


def facts_text(table: Table) -> str:
    """Returns a sentence that says what the figures are and what all rows share."""
    shared = printable(", ".join(f"{name.replace('_', ' ')} {value}" for name, value in table.facts.items()))
    return f"{repeats_text(table)}; {shared}." if shared else f"{repeats_text(table)}."


def format_table(table: Table, *, style: Literal["terminal", "markdown", "latex", "json"], color: bool = False) -> str:
    """Returns the table as text without a final line end; with `color`, the terminal shows the best in bold."""
    if style == "terminal":
        return _terminal(table, color=color)
    if style != "json":
        return (_markdown if style == "markdown" else _latex)(table)
    rows = [
        {
            "name": row.name,
            "kind": row.kind,
            "num_repeats": row.num_repeats,
            "figures": {c.metric: row.cells[c.metric]._asdict() for c in table.columns if c.metric in row.cells},
        }
        for row in table.rows
    ]
    columns = [column._asdict() for column in table.columns]
    text = json.dumps({**table.facts, "columns": columns, "rows": rows}, indent=2, ensure_ascii=False)
    # JSON allows control characters from 0x7f to 0x9f, but terminals obey them. Letters of all languages are kept.
    return "".join(c if c.isprintable() or c == "\n" else json.dumps(c)[1:-1] for c in text)


def _plain(cell: Cell | None) -> str:
    return f"{mean_text(cell)} ± {interval_text(cell)}" if cell else MISSING


def _terminal(table: Table, *, color: bool) -> str:
    # A name may contain control characters, which would move the terminal's cursor.
    names = [printable(row.name) for row in table.rows]
    texts = [[_plain(row.cells.get(column.metric)) for column in table.columns] for row in table.rows]
    widths = [
        max(len(heading(column)), *(len(row[number]) for row in texts)) for number, column in enumerate(table.columns)
    ]
    first = max(map(len, names))
    lines = [" " * first + "".join(f"  {heading(c):>{width}}" for c, width in zip(table.columns, widths, strict=True))]
    for name, row, cells in zip(names, table.rows, texts, strict=True):
        line = f"{name:{first}}"
        for column, width, text in zip(table.columns, widths, cells, strict=True):
            bold = color and column.metric in row.cells and row.cells[column.metric].best
            line += "  " + " " * (width - len(text)) + (f"\033[1m{text}\033[0m" if bold else text)
        lines.append(line)
    return "\n".join([*lines, "", facts_text(table)])


def _markdown(table: Table) -> str:
    def escaped(text: str) -> str:
        return re.sub(r"([\\`*_\[\]<>|])", r"\\\1", printable(text))

    def figure(cell: Cell | None) -> str:
        return f"**{mean_text(cell)}** ± {interval_text(cell)}" if cell and cell.best else _plain(cell)

    lines = [
        (escaped(row.name), *(figure(row.cells.get(column.metric)) for column in table.columns)) for row in table.rows
    ]
    text = markdown_table(("", *map(heading, table.columns)), lines)
    return f"{text}\n\n{escaped(facts_text(table))}"


LATEX = {
    **{character: f"\\{character}" for character in "{}$&#_%"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}
LATEX_ARROWS = {"higher": r" $\uparrow$", "lower": r" $\downarrow$", "real": r" $\rightarrow$", "none": ""}


def _latex(table: Table) -> str:
    def escaped(text: str) -> str:
        return "".join(LATEX.get(character, character) for character in printable(text))

    def figure(cell: Cell | None) -> str:
        if cell is None:
            return "--"
        mean = f"\\mathbf{{{mean_text(cell)}}}" if cell.best else mean_text(cell)
        return f"${mean}^{{\\pm{interval_text(cell)}}}$"

    headings = [f"{escaped(column.heading)}{LATEX_ARROWS[column.better]}" for column in table.columns]
    lines = [
        " & ".join([escaped(row.name), *(figure(row.cells.get(column.metric)) for column in table.columns)]) + r" \\"
        for row in table.rows
    ]
    return "\n".join(
        [
            r"% needs \usepackage{booktabs}",
            r"\begin{table}",
            r"  \centering",
            f"  \\caption{{{escaped(facts_text(table))}}}",
            f"  \\begin{{tabular}}{{l{'c' * len(table.columns)}}}",
            r"    \toprule",
            "    " + " & ".join(["", *headings]).lstrip() + r" \\",
            r"    \midrule",
            f"    {lines[0]}",
            r"    \midrule",
            *(f"    {line}" for line in lines[1:]),
            r"    \bottomrule",
            r"  \end{tabular}",
            r"\end{table}",
        ]
    )
