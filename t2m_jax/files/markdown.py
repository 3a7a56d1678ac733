"""Tables in Markdown."""

from collections.abc import Sequence

MIN_WIDTH = 4
"""Characters of the narrowest column of an aligned table: the rule of a column to the right is `---:`."""


def markdown_table(
    headings: Sequence[str], lines: Sequence[Sequence[str]], *, sides: str = "", aligned: bool = False
) -> str:
    """Returns a table without a final line end.

    Args:
        headings: Headings of the columns.
        lines: The cells of each line.
        sides: `<` (left) or `>` (right) for each column; by default, the first is to the left and the others right.
        aligned: Fill the cells with spaces, so that the table can also be read in a terminal.
    """
    sides = sides or "<" + ">" * (len(headings) - 1)
    sizes = [1] * len(headings)
    if aligned:
        sizes = [max(MIN_WIDTH, *map(len, column)) for column in zip(headings, *lines, strict=True)]
    dashes = {"<": lambda size: "-" * max(size, 3), ">": lambda size: "-" * max(size - 1, 3) + ":"}
    rule = [dashes[side](size) for side, size in zip(sides, sizes, strict=True)]
    table = []
    for line in (headings, rule, *lines):
        cells = [f"{cell:{side}{size}}" for cell, side, size in zip(line, sides, sizes, strict=True)]
        # An empty cell of a table that is not aligned is one space, not three.
        table.append("|" + "".join(f" {cell} |" if cell != " " else " |" for cell in cells))
    return "\n".join(table)
