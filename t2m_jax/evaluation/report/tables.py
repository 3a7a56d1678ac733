"""A table of reports as in papers: real motion first, then one row per report, and the best of each column."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

from t2m_jax.errors import UserError
from t2m_jax.evaluation.quality import CLEANED
from t2m_jax.evaluation.report.record import COMPARABLE, REAL, Metric, Report, first_difference

DIGITS = 3
"""Digits after the point, of means and intervals."""
CLOSE_TO_REAL = 0.9
"""Motion fits its captions if its R-precision (top 3) is at least this share of real motion's."""


class Column(NamedTuple):
    """One metric of the field's tables.

    MultiModality has a rule of its own. A model that ignores its captions has the highest variety, so higher is only
    better for motion that fits its captions: its R-precision (top 3) must be at least `CLOSE_TO_REAL` of real motion's.
    Other rows are never the best, and the column has no arrow if no generated motion in the table fits.
    """

    metric: str
    heading: str
    better: Literal["higher", "lower", "real", "none"]
    """Which values are better; `real`: those nearest to the value of real motion."""


COLUMNS = (
    Column("r_precision_1", "R top-1", "higher"),
    Column("r_precision_2", "R top-2", "higher"),
    Column("r_precision_3", "R top-3", "higher"),
    Column("fid", "FID", "lower"),
    Column("matching_score", "MM-Dist", "lower"),
    Column("diversity", "Diversity", "real"),
    Column("multimodality", "MModality", "higher"),
)
QUALITY_COLUMNS = (
    Column("bone_variation", "Bone variation", "lower"),
    Column("jerk", "Jerk", "real"),
    Column("skating_ratio", "Skating", "real"),
    Column("skating_speed", "Contact speed", "real"),
    Column("floating", "Floating", "real"),
    Column("penetration", "Penetration", "lower"),
)
Measures = Literal["captions", "labels", "quality"]
"""Which figures a table shows: the field's, those with R-precision by label, or the quality of motion."""


class Cell(NamedTuple):
    """One figure."""

    mean: float
    interval: float
    """Half-width of the 95 % interval."""
    best: bool = False


class Row(NamedTuple):
    """The metrics of one set of motions."""

    name: str
    kind: str
    """`real`, `reconstruction` or `generated`, as in the report."""
    num_repeats: int
    cells: dict[str, Cell]
    """Figures by metric; a row may lack some."""
    fits_captions: bool = False
    """Whether the R-precision (top 3) is close to that of the same report's real motion, see `Column`."""


class Table(NamedTuple):
    """Evaluations that can be compared, one per row, real motion first."""

    facts: dict[str, Any]
    """What all rows share: protocol, data, evaluator and so on."""
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]


def make_table(reports: Sequence[Report], names: Sequence[str], *, measures: Measures = "captions") -> Table:
    """Returns the table of reports: one row for real motion, then a row per report.

    The best figure of a column is marked if there are two or more rows of generated motion. Figures that are printed
    alike are equally good.

    Args:
        reports: One or more reports.
        names: Their rows' names.
        measures: With `labels`, R-precision does not count motions of the same label as errors.

    Raises:
        UserError: The reports cannot be compared or lack these figures, or a name is missing or given twice.
    """
    if not reports or len(names) != len(reports):
        raise UserError(f"names: {len(names)} given for {len(reports)} reports; give one for each")
    if len(set(names)) < len(names):
        raise UserError(f"names: {', '.join(names)} are not all different; give others with --names")
    facts = {name: getattr(reports[0].header, name) for name in COMPARABLE}
    for report, title in zip(reports, names, strict=True):
        if name := first_difference(reports[0].header, report.header, COMPARABLE):
            values = [getattr(one.header, name) for one in (reports[0], report)]
            raise UserError(f"{name}: {values[0]} in {names[0]}, {values[1]} in {title}; make a table for each")
    # Real motion of the report with the most repeats; the others' repeats are its first ones.
    real = max((_row("real motion", REAL, report.real) for report in reports), key=lambda row: row.num_repeats)
    titles = [" ".join(title.split()) for title in names]
    rows = [
        _row(title, report.kind, report.measured)._replace(fits_captions=fits_captions(report))
        for report, title in zip(reports, titles, strict=True)
    ]
    if measures == "quality":
        rows += [row for report, title in zip(reports, titles, strict=True) if (row := _cleaned_row(title, report))]
    known = {metric for row in (real, *rows) for metric in row.cells}
    wanted = list(QUALITY_COLUMNS if measures == "quality" else COLUMNS)
    if measures == "labels":
        wanted = [_by_label(column) for column in COLUMNS]
    if measures != "captions" and wanted[0].metric not in known:
        labels, quality = (
            f"{facts['data']} has no labels (column `label` of its index.csv)",
            "evaluate the models again",
        )
        raise UserError(f"{measures}: not in these reports; {labels if measures == 'labels' else quality}")
    if not any(row.fits_captions for row in rows if row.kind == "generated"):
        wanted = [c._replace(better="none") if c.metric == "multimodality" else c for c in wanted]
    columns = tuple(column for column in wanted if column.metric in known)
    for column in columns:
        for row in _best_rows(column, real, rows):
            row.cells[column.metric] = row.cells[column.metric]._replace(best=True)
    return Table(facts, columns, (real, *rows))


def _row(name: str, kind: str, metrics: dict[str, Metric]) -> Row:
    cells = {metric: Cell(found.mean, found.interval) for metric, found in metrics.items()}
    return Row(name, kind, max((len(found.repeats) for found in metrics.values()), default=0), cells)


def _cleaned_row(title: str, report: Report) -> Row | None:
    """Returns the quality of a report's motion after the clean-up; None in reports that do not have it."""
    cleaned = {name.removeprefix(CLEANED): found for name, found in report.measured.items() if name.startswith(CLEANED)}
    return _row(f"{title}, cleaned", report.kind, cleaned) if cleaned else None


def _by_label(column: Column) -> Column:
    """Returns the column with labels if the metric has one."""
    if not column.metric.startswith("r_precision"):
        return column
    return column._replace(metric=f"{column.metric}_by_label", heading=f"{column.heading} by label")


def _best_rows(column: Column, real: Row, rows: Sequence[Row]) -> list[Row]:
    """Returns the rows of generated motion that are best in a column; none if fewer than two can be compared."""
    rivals = [row for row in rows if row.kind == "generated" and column.metric in row.cells]
    if column.metric == "multimodality":
        rivals = [row for row in rivals if row.fits_captions]
    if len(rivals) < 2 or (column.better == "real" and column.metric not in real.cells):
        return []
    # Rounded as printed, so that figures that are printed alike are equally good; larger is better from here on.
    values = [round(row.cells[column.metric].mean, DIGITS) for row in rivals]
    if column.better == "lower":
        values = [-value for value in values]
    elif column.better == "real":
        target = round(real.cells[column.metric].mean, DIGITS)
        values = [-round(abs(value - target), DIGITS) for value in values]
    return [row for row, value in zip(rivals, values, strict=True) if value == max(values)]


def fits_captions(report: Report) -> bool:
    """Returns whether the R-precision (top 3) of a report's motion is close to its real motion's, see `Column`."""
    measured, real = (metrics.get("r_precision_3") for metrics in (report.measured, report.real))
    return measured is not None and real is not None and measured.mean >= CLOSE_TO_REAL * real.mean
