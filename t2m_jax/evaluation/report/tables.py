"""A table of reports as in papers: real motion first, then one line per report, and the best of each column."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

from t2m_jax.errors import UserError
from t2m_jax.evaluation.report.record import CLEANED, COMPARABLE, REAL, Metric, Report, first_difference

DIGITS = 3
"""Digits after the point, of means and intervals."""
CLOSE_TO_REAL = 0.9
"""Motion fits its captions if its R-precision (top 3) is at least this share of real motion's."""


class Column(NamedTuple):
    """One metric of the field's tables.

    MultiModality has a rule of its own. A model that ignores its captions has the highest variety, so higher is only
    better for motion that fits its captions: its R-precision (top 3) must be at least `CLOSE_TO_REAL` of real motion's.
    Other motion is never the best, and the column has no arrow if no generated motion in the table fits.
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
FOLLOWING_COLUMN = "text_following"
BENCHMARK_COLUMNS = (
    *(COLUMNS[0], COLUMNS[2], COLUMNS[3], Column("fid_normalized", "FID, unit length", "lower"), *COLUMNS[4:]),
    Column("jerk", "Jerk", "real"),
    Column("skating_ratio", "Skating", "real"),
    Column("floating", "Floating", "real"),
    Column(FOLLOWING_COLUMN, "Follows", "higher"),
)
Measures = Literal["captions", "labels", "quality", "benchmark"]
"""Which figures a table shows: the field's, those with R-precision by label, the quality of motion, or a choice of all
with text following."""


class Cell(NamedTuple):
    """One figure."""

    mean: float
    interval: float | None
    """Half-width of the 95 % interval; None for a single repeat, which has none."""
    best: bool = False


class TableLine(NamedTuple):
    """The metrics of one set of motions."""

    name: str
    kind: str
    """`real`, `reconstruction` or `generated`, as in the report."""
    num_repeats: int
    cells: dict[str, Cell]
    """Figures by metric; a line may lack some."""
    fits_captions: bool = False
    """Whether the R-precision (top 3) is close to that of the same report's real motion, see `Column`."""


class Table(NamedTuple):
    """Evaluations that can be compared, one per line, real motion first."""

    facts: dict[str, Any]
    """What all lines share: protocol, data, evaluator and so on."""
    columns: tuple[Column, ...]
    lines: tuple[TableLine, ...]
    note: str = ""
    """What a reader of the figures must know, if there is anything."""


def make_table(reports: Sequence[Report], names: Sequence[str], *, measures: Measures = "captions") -> Table:
    """Returns the table of reports: one line for real motion, then a line per report.

    The best figure of a column is marked if there are two or more lines of generated motion. Figures that are printed
    alike are equally good.

    Args:
        reports: One or more reports.
        names: The names of their lines.
        measures: With `labels`, R-precision does not count motions of the same label as errors.

    Raises:
        UserError: The reports cannot be compared or lack these figures, or a name is missing or given twice.
    """
    _check_comparable(reports, names)
    # Real motion of the report with the most repeats; the others' repeats are its first ones.
    real = max((_line("real motion", REAL, report.real) for report in reports), key=lambda line: line.num_repeats)
    titles = [" ".join(title.split()) for title in names]
    lines = [
        _line(title, report.kind, report.measured)._replace(fits_captions=fits_captions(report))
        for report, title in zip(reports, titles, strict=True)
    ]
    for report, title in zip(reports, titles, strict=True) if measures == "quality" else ():
        measured = report.measured.items()
        cleaned = {name.removeprefix(CLEANED): found for name, found in measured if name.startswith(CLEANED)}
        lines += [_line(f"{title}, cleaned", report.kind, cleaned)] if cleaned else []
    known = {metric for line in (real, *lines) for metric in line.cells}
    for report, line in zip(reports, lines, strict=True) if measures == "benchmark" else ():
        line.cells.update(_following_cell(report))
        known |= line.cells.keys()
    wanted = {
        "captions": COLUMNS,
        "labels": tuple(map(_by_label, COLUMNS)),
        "quality": QUALITY_COLUMNS,
        "benchmark": BENCHMARK_COLUMNS,
    }[measures]
    header = dataclasses.asdict(reports[0].header)
    facts = {name: header[name] for name in COMPARABLE}
    if measures in ("labels", "quality") and wanted[0].metric not in known:
        labels = f"{facts['data']} has no labels (column `label` of its index.csv)"
        advice = labels if measures == "labels" else "evaluate the models again"
        raise UserError(f"{measures}: not in these reports; {advice}")
    if not any(line.fits_captions for line in lines if line.kind == "generated"):
        wanted = tuple(c._replace(better="none") if c.metric == "multimodality" else c for c in wanted)
    columns = tuple(column for column in wanted if column.metric in known)
    for column in columns:
        for line in _best_lines(column, real, lines):
            line.cells[column.metric] = line.cells[column.metric]._replace(best=True)
    warnings = [report.header.fid_warning for report in reports if "fid" in (column.metric for column in columns)]
    return Table(facts, columns, (real, *lines), next(filter(None, warnings), ""))


def _check_comparable(reports: Sequence[Report], names: Sequence[str]) -> None:
    """Raises `UserError` if reports and names do not make a table."""
    if not reports or len(names) != len(reports):
        raise UserError(f"names: {len(names)} given for {len(reports)} reports; give one for each")
    if len(set(names)) < len(names):
        raise UserError(f"names: {', '.join(names)} are not all different; give others with --names")
    for report, title in zip(reports, names, strict=True):
        if difference := first_difference(reports[0].header, report.header, COMPARABLE):
            field, one, other = difference
            raise UserError(f"{field}: {one} in {names[0]}, {other} in {title}; make a table for each")


def _line(name: str, kind: str, metrics: dict[str, Metric]) -> TableLine:
    cells = {
        metric: Cell(found.mean, found.interval if len(found.repeats) > 1 else None)
        for metric, found in metrics.items()
    }
    return TableLine(name, kind, max((len(found.repeats) for found in metrics.values()), default=0), cells)


def _following_cell(report: Report) -> dict[str, Cell]:
    """Returns the share of the motions that did what was asked, over all groups, with its binomial 95 % interval."""
    groups = (report.following or {}).values()
    samples = sum(group.samples for group in groups)
    if not samples:
        return {}
    share = sum(group.right for group in groups) / samples
    return {FOLLOWING_COLUMN: Cell(share, 1.96 * math.sqrt(share * (1 - share) / samples))}


def _by_label(column: Column) -> Column:
    """Returns the column with labels if the metric has one."""
    if not column.metric.startswith("r_precision"):
        return column
    return column._replace(metric=f"{column.metric}_by_label", heading=f"{column.heading} by label")


def _best_lines(column: Column, real: TableLine, lines: Sequence[TableLine]) -> list[TableLine]:
    """Returns the lines of generated motion that are best in a column; none if fewer than two can be compared."""
    rivals = [line for line in lines if line.kind == "generated" and column.metric in line.cells]
    if column.metric == "multimodality":
        rivals = [line for line in rivals if line.fits_captions]
    if len(rivals) < 2 or (column.better == "real" and column.metric not in real.cells):
        return []
    # Rounded as printed, so that figures that are printed alike are equally good; larger is better from here on.
    values = [round(line.cells[column.metric].mean, DIGITS) for line in rivals]
    if column.better == "lower":
        values = [-value for value in values]
    elif column.better == "real":
        target = round(real.cells[column.metric].mean, DIGITS)
        values = [-round(abs(value - target), DIGITS) for value in values]
    return [line for line, value in zip(rivals, values, strict=True) if value == max(values)]


def fits_captions(report: Report) -> bool:
    """Returns whether the R-precision (top 3) of a report's motion is close to its real motion's, see `Column`."""
    measured, real = (metrics.get("r_precision_3") for metrics in (report.measured, report.real))
    return measured is not None and real is not None and measured.mean >= CLOSE_TO_REAL * real.mean
