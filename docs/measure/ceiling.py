"""Measures what real motion reaches on the benchmark, and how much figures change for other reasons than a model.

    python docs/measure/ceiling.py data/benchmark-free benchmark-free [--reports demo.json] [--plot ceiling.png]

For each evaluator and for the splits test and val: R-precision and MM-Dist of real motion with other draws of captions
and pieces, and the FID of one half of the real clips to the other half, for other halves. Twins stay together. The
intervals have 95 % of the repeats, so a difference within them says nothing about a model. Reports of `t2m benchmark`
are shown below, with such intervals, too.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from t2m_jax.checkpoints import load_trained_evaluator
from t2m_jax.data import open_dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation import EvaluationTask, embed_plan_captions, embed_plan_motions, find_protocol, make_task
from t2m_jax.evaluation.benchmark import UNIT
from t2m_jax.evaluation.report import format_table, load_report
from t2m_jax.evaluation.report.charts import check_chart, save_chart, table_chart
from t2m_jax.evaluation.report.tables import BENCHMARK_COLUMNS, Cell, Table, TableLine
from t2m_jax.metrics import fid, matching_score, r_precision
from t2m_jax.motion.rotations import unit_vectors

SHOWN = ("r_precision_1", "r_precision_3", "fid", "fid_normalized", "matching_score")


def real_metrics(task: EvaluationTask, repeat: int) -> dict[str, float]:
    """Returns the metrics of one repeat; FID is that of one half of the recordings to the other half."""
    plan = task.plan(repeat)
    texts, motions = embed_plan_captions(task, plan), embed_plan_motions(task, plan)
    top = r_precision(jnp.asarray(texts), jnp.asarray(motions), batch=task.protocol.batch)
    # A twin is beside its original in the lists, and shows the same.
    pairs = plan.samples // 2
    chosen = np.random.default_rng([task.seed, repeat]).permutation(np.unique(pairs))
    is_first = np.isin(pairs, chosen[: len(chosen) // 2])
    halves = motions[is_first], motions[~is_first]
    return {
        "r_precision_1": float(top[0]),
        "r_precision_3": float(top[2]),
        "fid": float(fid(*map(jnp.asarray, halves))),
        "fid_normalized": float(fid(*(jnp.asarray(unit_vectors(half)) for half in halves))),
        "matching_score": float(matching_score(jnp.asarray(texts), jnp.asarray(motions))),
    }


def lines(data: str, evaluators: list[str], *, num_repeats: int) -> Iterator[TableLine]:
    """Yields a line for each evaluator and split."""
    dataset = open_dataset(data)
    for name in evaluators:
        evaluator = load_trained_evaluator(name)
        for split in ("test", "val"):
            task = make_task(dataset, evaluator, find_protocol("benchmark"), split=split, seed=0, unit=UNIT)
            found = [real_metrics(task, repeat) for repeat in range(num_repeats)]
            values = {metric: np.array([one[metric] for one in found]) for metric in SHOWN}
            yield make_line(f"real motion, {Path(name).name}, {split}", values)


def make_line(name: str, values: dict[str, np.ndarray]) -> TableLine:
    """Returns a line with mean and range of the repeats of each metric."""
    # Not over the root of the number of repeats: each repeat is one way in which a table might have turned out.
    cells = {metric: Cell(float(some.mean()), float(1.96 * some.std(ddof=1))) for metric, some in values.items()}
    return TableLine(name, "generated", max(map(len, values.values())), cells)


def report_line(path: Path) -> TableLine:
    """Returns the line of the motion of a report."""
    measured = load_report(path).measured
    return make_line(path.stem, {metric: np.array(measured[metric].repeats) for metric in SHOWN})


def main() -> None:
    """Prints the table, and draws it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data")
    parser.add_argument("evaluators", nargs="+")
    parser.add_argument("--num-repeats", type=int, default=20)
    parser.add_argument("--reports", nargs="+", type=Path, default=[])
    parser.add_argument("--plot", type=Path)
    args = parser.parse_args()
    if args.num_repeats < 2:
        raise UserError("--num-repeats: give 2 or more")
    if args.plot:
        check_chart(args.plot)
    columns = tuple(column for column in BENCHMARK_COLUMNS if column.metric in SHOWN)
    found = [*lines(args.data, args.evaluators, num_repeats=args.num_repeats), *map(report_line, args.reports)]
    table = Table({}, columns, (TableLine("", "real", args.num_repeats, {}), *found))
    printed = format_table(table._replace(lines=tuple(found)), style="markdown")
    sys.stdout.write(printed.replace("Mean and 95 % interval over", "Mean, and what 95 % are in, of") + "\n")
    if args.plot:
        figure = table_chart(table)
        figure.supxlabel("Means, and what 95 % of the repeats are in.", fontsize="x-small")
        save_chart(args.plot, figure)


if __name__ == "__main__":
    main()
