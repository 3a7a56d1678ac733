"""A table of evaluations as papers have it: real motion first, each model a row, the best of a column known."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

from t2m_jax.errors import UserError
from t2m_jax.evaluation.report.record import SAME

DIGITS = 3
"""Digits after the point, of means and intervals."""


class Column(NamedTuple):
    """One metric of the field's tables."""

    metric: str
    heading: str
    better: Literal["higher", "lower", "real"]
    """Which values are better; `real`: those nearest to real motion's."""


COLUMNS = (
    Column("r_precision_1", "R top-1", "higher"),
    Column("r_precision_2", "R top-2", "higher"),
    Column("r_precision_3", "R top-3", "higher"),
    Column("fid", "FID", "lower"),
    Column("matching_score", "MM-Dist", "lower"),
    Column("diversity", "Diversity", "real"),
    Column("multimodality", "MModality", "higher"),
)


class Cell(NamedTuple):
    """One figure."""

    mean: float
    interval: float
    """Half-width of the 95 % interval."""
    best: bool = False


class Row(NamedTuple):
    """What was measured of one set of motions."""

    name: str
    kind: str
    """`real`, `reconstruction` or `generated`, as in the report."""
    num_repeats: int
    cells: dict[str, Cell]
    """By metric; not every row has every one."""


class Table(NamedTuple):
    """Evaluations that compare, one a row, real motion first."""

    facts: dict[str, Any]
    """What all rows share: protocol, data, evaluator and so on."""
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]


def _by_label(column: Column) -> Column:
    """Returns the label-aware column where there is one of the kind."""
    if not column.metric.startswith("r_precision"):
        return column
    return column._replace(metric=f"{column.metric}_by_label", heading=f"{column.heading} by label")


def make_table(reports: Sequence[Mapping[str, Any]], names: Sequence[str], *, by_label: bool = False) -> Table:
    """Returns the table of reports: real motion once, then what each report measured, under the report's name.

    The best figure of a column is marked among the rows of generated motion, where there are two or more. Figures
    that read the same are equally good. With `by_label` R-precision is the one that does not count motions of the same
    label as errors.

    Raises:
        UserError: if the reports do not compare, names are missing or given twice, or nothing is known of labels.
    """
    if not reports or len(names) != len(reports):
        raise UserError(f"names: {len(names)} given for {len(reports)} reports; each needs one")
    if len(set(names)) < len(names):
        raise UserError(f"names: {', '.join(names)} are not all different; give others with --names")
    facts = {name: reports[0][name] for name in SAME}
    for report, title in zip(reports, names, strict=True):
        for name in SAME:
            if report[name] != facts[name]:
                raise UserError(
                    f"{name}: {facts[name]} in {names[0]}, {report[name]} in {title}; they do not stand in one table"
                )
    rows = [_real_row(reports)]
    for report, title in zip(reports, names, strict=True):
        (kind,) = report["rows"].keys() - {"real"}
        rows.append(_row(" ".join(title.split()), kind, report["rows"][kind]))
    known = {metric for row in rows for metric in row.cells}
    wanted = [_by_label(column) if by_label else column for column in COLUMNS]
    if by_label and wanted[0].metric not in known:
        raise UserError(f"by label: {facts['data']} says nothing of labels (column `label` of its index.csv)")
    columns = tuple(column for column in wanted if column.metric in known)
    return Table(facts, columns, _with_best(rows, columns))


def _real_row(reports: Sequence[Mapping[str, Any]]) -> Row:
    """Returns the row of real motion, from the report that repeated most: the others' repeats are its first."""
    rows = [_row("real motion", "real", report["rows"]["real"]) for report in reports]
    return max(rows, key=lambda row: row.num_repeats)


def _row(name: str, kind: str, figures: Mapping[str, Any]) -> Row:
    cells = {metric: Cell(found["mean"], found["interval"]) for metric, found in figures.items()}
    return Row(name, kind, max((len(found["repeats"]) for found in figures.values()), default=0), cells)


def _with_best(rows: Sequence[Row], columns: Sequence[Column]) -> tuple[Row, ...]:
    """Returns the rows with the best generated motion marked in each column."""
    marked = list(rows)
    for column in columns:
        real = rows[0].cells.get(column.metric)
        rivals = [number for number, row in enumerate(rows) if row.kind == "generated" and column.metric in row.cells]
        if len(rivals) < 2 or (column.better == "real" and real is None):
            continue
        distances = {number: _distance_from_best(rows[number].cells[column.metric], column, real) for number in rivals}
        for number, distance in distances.items():
            if distance == min(distances.values()):
                row = marked[number]
                cell = row.cells[column.metric]._replace(best=True)
                marked[number] = row._replace(cells=row.cells | {column.metric: cell})
    return tuple(marked)


def _distance_from_best(cell: Cell, column: Column, real: Cell | None) -> float:
    """Returns a number that is smaller for better figures, and equal for those that are printed alike."""
    mean = round(cell.mean, DIGITS)
    if column.better == "real" and real is not None:
        return round(abs(mean - round(real.mean, DIGITS)), DIGITS)
    return -mean if column.better == "higher" else mean
