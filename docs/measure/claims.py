"""Compares the trainings of configs/claims, three seeds each: means, intervals over the trainings, and differences.

    python docs/measure/claims.py reports

Prints Markdown: a table of tokenizers, a table of generators, and the differences of docs/results.md. All intervals are
95 % by Student's t over trainings; a difference has that of Welch's test, or of the paired test if both are measured of
the same trainings. Names without a report are left out.
"""

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from t2m_jax.evaluation.report import format_table
from t2m_jax.evaluation.report.tables import BENCHMARK_COLUMNS, FOLLOWING_COLUMN, Cell, Column, Table, TableLine

SEEDS = 3
TOKENIZERS = (
    *(column for column in BENCHMARK_COLUMNS if column.metric in {"r_precision_1", "fid", "jerk"}),
    Column("mpjpe_mm", "MPJPE, mm", "lower"),
    Column("global_mpjpe_mm", "global MPJPE, mm", "lower"),
    Column("perplexity", "Perplexity", "none"),
)
GENERATORS = BENCHMARK_COLUMNS
DIFFERENCES = (
    ("rvq-10-256", "vq"),
    ("rvq-2-512", "vq"),
    ("rvq-10-256", "rvq-2-256"),
    *((f"rvq-{deep}-256", f"rvq-{flat}-256") for flat, deep in ((1, 2), (2, 4), (4, 6), (6, 10), (10, 12))),
    *((f"rvq-10-{large}", f"rvq-10-{small}") for small, large in ((128, 256), (256, 512), (512, 1024))),
    *((f"gpt-{tau}", "gpt-0.0") for tau in ("0.3", "0.5", "per_motion")),
    *(("gpt-states", f"gpt-{other}") for other in ("vector", "0.5")),
    ("hifigpt-rows", "gpt-0.5"),
    *(("hifigpt-rows", f"hifigpt-{other}") for other in ("codes", "none")),
    *(("hifigpt-rows", f"hifigpt-guidance-{scale}") for scale in (1, 4)),
    *(("hifigpt-rows", f"hifigpt-stop-{rule}") for rule in ("argmax", "threshold")),
    ("hifigpt-rows", "hifigpt-candidates-4"),
    *(("hifigpt-rows", f"hifigpt-data-{share}") for share in (0.25, 0.5)),
)
"""What is compared with what: the claims of the two papers."""
SAME_TRAININGS = ("hifigpt-guidance-", "hifigpt-stop-", "hifigpt-candidates-")
"""Names that begin so are measured of the trainings of `hifigpt-rows`, with other options."""
COMPARED = ("r_precision_1", "fid", "mpjpe_mm", FOLLOWING_COLUMN)
"""By which figures."""

Figures = Mapping[str, list[float]]
"""Of the seeds, by metric."""


def figures_of(report: Mapping[str, Any]) -> dict[str, float]:
    """Returns the figures of one report: means of its repeats, and what is measured once."""
    rows = next(rows for kind, rows in report["rows"].items() if kind != "real")
    once = {name: report[name] for name in ("mpjpe_mm", "global_mpjpe_mm", "perplexity") if name in report}
    groups = (report.get("following") or {}).values()
    asked = sum(group["samples"] for group in groups)
    followed = {FOLLOWING_COLUMN: sum(group["right"] for group in groups) / asked} if asked else {}
    return {name: row["mean"] for name, row in rows.items()} | once | followed


def read_reports(folder: Path) -> dict[str, Figures]:
    """Returns the figures of each name of which there are reports of all seeds."""
    found: dict[str, Figures] = {}
    names = [path.stem.removesuffix("-0") for path in folder.glob("*-0.json")]
    # Numbers by their size: a depth of 10 after one of 6.
    for name in sorted(names, key=lambda name: [part.zfill(8) for part in name.split("-")]):
        paths = [folder / f"{name}-{seed}.json" for seed in range(SEEDS)]
        if all(path.is_file() for path in paths):
            each = [figures_of(json.loads(path.read_text())) for path in paths]
            found[name] = {metric: [one[metric] for one in each] for metric in each[0]}
    return found


def line_of(name: str, figures: Figures) -> TableLine:
    """Returns the line of a table: the mean over trainings, and the interval of this mean."""
    scale = stats.t.ppf(0.975, SEEDS - 1) / np.sqrt(SEEDS)
    cells = {metric: Cell(float(np.mean(of)), float(scale * np.std(of, ddof=1))) for metric, of in figures.items()}
    return TableLine(name, "generated", SEEDS, cells)


def difference(left: list[float], right: list[float], *, is_paired: bool) -> str:
    """Returns the difference of two means with its interval, and whether it can be told from none."""
    test = stats.ttest_rel(left, right) if is_paired else stats.ttest_ind(left, right, equal_var=False)
    interval = test.confidence_interval()
    middle = (interval.low + interval.high) / 2
    says = "more" if interval.low > 0 else "less" if interval.high < 0 else "cannot be said"
    return f"{middle:+.3f} ± {(interval.high - interval.low) / 2:.3f} | {says}"


def main() -> None:
    """Prints tables and differences."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reports", type=Path)
    found = read_reports(parser.parse_args().reports)
    for columns, is_tokenizer in ((TOKENIZERS, True), (GENERATORS, False)):
        lines = tuple(line_of(name, of) for name, of in found.items() if ("mpjpe_mm" in of) == is_tokenizer)
        if lines:
            table = format_table(Table({}, columns, lines), style="markdown")
            sys.stdout.write(table.replace("repeats", "trainings") + "\n\n")
    sys.stdout.write("| | | metric | difference | |\n| --- | --- | --- | ---: | --- |\n")
    for left, right in DIFFERENCES:
        for metric in COMPARED:
            if metric in found.get(left, {}) and metric in found.get(right, {}):
                is_paired = right.startswith(SAME_TRAININGS)
                told = difference(found[left][metric], found[right][metric], is_paired=is_paired)
                sys.stdout.write(f"| {left} | {right} | {metric} | {told} |\n")


if __name__ == "__main__":
    main()
