"""Tables as text for the terminal, Markdown, LaTeX and JSON: mean and 95 % interval, arrows, the best in bold."""

import json
import re
from typing import Literal

from t2m_jax.errors import printable
from t2m_jax.evaluation.report.tables import DIGITS, Cell, Column, Table
from t2m_jax.files.markdown import markdown_table

MISSING = "-"
"""Printed if a line has no such figure."""
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
    counts = sorted({line.num_repeats for line in table.lines})
    repeats = "1 repeat" if counts == [1] else " to ".join(map(str, [*counts[:1], *counts[1:][-1:]])) + " repeats"
    return f"Mean and 95 % interval over {repeats}"


def facts_text(table: Table) -> str:
    """Returns a sentence that says what the figures are and what all lines share."""
    shared = printable(", ".join(f"{name.replace('_', ' ')} {value}" for name, value in table.facts.items()))
    return f"{repeats_text(table)}; {shared}." if shared else f"{repeats_text(table)}."


def format_table(table: Table, *, style: Literal["terminal", "markdown", "latex", "json"], color: bool = False) -> str:
    """Returns the table as text without a final line end; with `color`, the terminal shows the best in bold."""
    if style == "terminal":
        return _terminal(table, color=color)
    if style != "json":
        return (_markdown if style == "markdown" else _latex)(table)
    lines = [
        {
            "name": line.name,
            "kind": line.kind,
            "num_repeats": line.num_repeats,
            "figures": {c.metric: line.cells[c.metric]._asdict() for c in table.columns if c.metric in line.cells},
        }
        for line in table.lines
    ]
    columns = [column._asdict() for column in table.columns]
    text = json.dumps({**table.facts, "columns": columns, "rows": lines}, indent=2, ensure_ascii=False)
    # JSON allows control characters from 0x7f to 0x9f, but terminals obey them. Letters of all languages are kept.
    return "".join(c if c.isprintable() or c == "\n" else json.dumps(c)[1:-1] for c in text)


def _plain(cell: Cell | None) -> str:
    return f"{mean_text(cell)} ± {interval_text(cell)}" if cell else MISSING


def _terminal(table: Table, *, color: bool) -> str:
    # A name may contain control characters, which would move the terminal's cursor.
    names = [printable(line.name) for line in table.lines]
    first = max(map(len, names))
    parts = [[" " * first, *(f"{name:{first}}" for name in names)]]
    for column in table.columns:
        cells = [line.cells.get(column.metric) for line in table.lines]
        width = max(len(heading(column)), *(len(_plain(cell)) for cell in cells))
        texts = [heading(column).rjust(width)]
        for cell in cells:
            text = _plain(cell)
            is_bold = color and cell is not None and cell.best
            # Padded without the codes of bold text, which take no room in a terminal.
            texts.append(" " * (width - len(text)) + (f"\033[1m{text}\033[0m" if is_bold else text))
        parts.append(texts)
    lines = ["  ".join(line) for line in zip(*parts, strict=True)]
    return "\n".join([*lines, "", facts_text(table)])


def _markdown(table: Table) -> str:
    def escaped(text: str) -> str:
        return re.sub(r"([\\`*_\[\]<>|])", r"\\\1", printable(text))

    def figure(cell: Cell | None) -> str:
        return f"**{mean_text(cell)}** ± {interval_text(cell)}" if cell and cell.best else _plain(cell)

    lines = [
        (escaped(line.name), *(figure(line.cells.get(column.metric)) for column in table.columns))
        for line in table.lines
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
        # Character by character: replacements contain characters that are replaced themselves.
        return "".join(LATEX.get(character, character) for character in printable(text))

    def figure(cell: Cell | None) -> str:
        if cell is None:
            return "--"
        mean = f"\\mathbf{{{mean_text(cell)}}}" if cell.best else mean_text(cell)
        return f"${mean}^{{\\pm{interval_text(cell)}}}$"

    headings = [f"{escaped(column.heading)}{LATEX_ARROWS[column.better]}" for column in table.columns]
    lines = [
        " & ".join([escaped(line.name), *(figure(line.cells.get(column.metric)) for column in table.columns)]) + r" \\"
        for line in table.lines
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
            # Real motion has a part of its own, because it is no rival.
            f"    {lines[0]}",
            r"    \midrule",
            *(f"    {line}" for line in lines[1:]),
            r"    \bottomrule",
            r"  \end{tabular}",
            r"\end{table}",
        ]
    )
