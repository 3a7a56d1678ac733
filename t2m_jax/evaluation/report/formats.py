"""Tables as text for the terminal, Markdown and LaTeX: mean and 95 % interval, arrows, the best in bold."""

import re
from collections.abc import Callable
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
    """Returns the half-width as papers print it: `.003`, without the zero before the point; empty if there is none."""
    return "" if cell.interval is None else f"{cell.interval:.{DIGITS}f}".removeprefix("0")


def facts_text(table: Table) -> str:
    """Returns sentences that say what the figures are, what all lines share, and what a reader must know."""
    counts = sorted({line.num_repeats for line in table.lines})
    repeats = " to ".join(map(str, [*counts[:1], *counts[1:][-1:]])) + " repeats"
    shared = printable(", ".join(f"{name.replace('_', ' ')} {value}" for name, value in table.facts.items()))
    figures = "Figures of one repeat" if counts == [1] else f"Mean and 95 % interval over {repeats}"
    figures += f"; {shared}." if shared else "."
    return f"{figures} {table.note}".rstrip()


def format_table(table: Table, *, style: Literal["terminal", "markdown", "latex"], color: bool = False) -> str:
    """Returns the table as text without a final line end; with `color`, the terminal shows the best in bold."""
    if style == "terminal":
        return _terminal(table, color=color)
    return (_markdown if style == "markdown" else _latex)(table)


def table_grid(table: Table, name: Callable[[str], str], figure: Callable[[Cell | None], str]) -> list[list[str]]:
    """Returns the texts of a table's lines: the name, and the figure of each column."""
    return [
        [name(line.name), *(figure(line.cells.get(column.metric)) for column in table.columns)] for line in table.lines
    ]


def _plain(cell: Cell | None) -> str:
    return _with_interval(cell, mean_text(cell)) if cell else MISSING


def _with_interval(cell: Cell, mean: str) -> str:
    interval = interval_text(cell)
    return f"{mean} ± {interval}" if interval else mean


def _terminal(table: Table, *, color: bool) -> str:
    def figure(cell: Cell | None) -> str:
        return f"\033[1m{_plain(cell)}\033[0m" if color and cell is not None and cell.best else _plain(cell)

    # A name may contain control characters, which would move the terminal's cursor.
    grid = [["", *map(heading, table.columns)], *table_grid(table, printable, figure)]
    # The codes of bold text take no room in a terminal.
    sizes = [[len(re.sub(r"\033\[\d*m", "", text)) for text in line] for line in grid]
    widths = [max(column) for column in zip(*sizes, strict=True)]
    lines = []
    for texts, own in zip(grid, sizes, strict=True):
        spaces = [" " * (width - size) for width, size in zip(widths, own, strict=True)]
        lines.append("  ".join([texts[0] + spaces[0], *map("".join, zip(spaces[1:], texts[1:], strict=True))]))
    return "\n".join([*lines, "", facts_text(table)])


def _markdown(table: Table) -> str:
    def escaped(text: str) -> str:
        return re.sub(r"([\\`*_\[\]<>|])", r"\\\1", printable(text))

    def figure(cell: Cell | None) -> str:
        return _with_interval(cell, f"**{mean_text(cell)}**") if cell and cell.best else _plain(cell)

    text = markdown_table(("", *map(heading, table.columns)), table_grid(table, escaped, figure))
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
        interval = interval_text(cell)
        return f"${mean}^{{\\pm{interval}}}$" if interval else f"${mean}$"

    headings = [f"{escaped(column.heading)}{LATEX_ARROWS[column.better]}" for column in table.columns]
    lines = [" & ".join(line) + r" \\" for line in table_grid(table, escaped, figure)]
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
