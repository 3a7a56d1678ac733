"""Draw the loss curves of runs in one figure: `t2m plot runs/a runs/b -o curves.png`.

Each run has a color. Its loss in training is pale, and its validation loss strong. `--metric` draws another column of
the files `train.csv`, `val.csv` and `evaluation.csv` of the runs. It needs the extra `plot`.
"""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from t2m_jax.cli.options import show_next
from t2m_jax.errors import UserError, printable

if TYPE_CHECKING:
    from t2m_jax.evaluation.report.charts import MetricCurve

SPLITS = ("train", "val", "evaluation")
"""Names of the logs of a run."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="run folders")
    file = "figure to write, a .png, .svg or .pdf file (default: curves.png)"
    parser.add_argument("-o", "--output", type=Path, default=Path("curves.png"), metavar="FILE", help=file)
    parser.add_argument("--metric", default="loss", help="column of the logs, such as accuracy or fid (default: loss)")


def run(args: argparse.Namespace) -> None:
    """Writes the figure and prints its name."""
    from t2m_jax.evaluation.report.charts import check_chart, curves_chart, save_chart
    from t2m_jax.files.writing import check_output

    check_chart(check_output(args.output))
    curves = {f"{path}": load_curves(path, args.metric) for path in args.runs}
    save_chart(args.output, curves_chart(curves, metric=args.metric))
    sys.stdout.write(f"{printable(str(args.output))}\n")
    show_next(f"open {args.output}")


def load_curves(run: Path, metric: str) -> "dict[str, MetricCurve]":
    """Returns the curves of a metric in the logs of a run, by the name of the log.

    Raises:
        UserError: The folder has no logs, no log has this metric, or one is damaged.
    """
    from t2m_jax.train.log import whole_lines

    curves: dict[str, MetricCurve] = {}
    known: set[str] = set()
    for split in SPLITS:
        path = run / f"{split}.csv"
        if path.is_file():
            header, *rows = (line.rstrip("\n").split(",") for line in whole_lines(path))
            known |= set(header) if rows else set()
            if rows and metric in header:
                curves[split] = _curve(path, rows, header.index(metric), metric)
    if not known:
        raise UserError(f"{run}: has no logs of a training (train.csv); give the folder of a run that has begun")
    if not curves:
        raise UserError(f"{run}: its logs have no {metric!r}; they have {', '.join(sorted(known - {'step'}))}")
    return curves


def _curve(path: Path, rows: list[list[str]], column: int, metric: str) -> "MetricCurve":
    from t2m_jax.evaluation.report.charts import MetricCurve

    try:
        return MetricCurve([int(row[0]) for row in rows], [float(row[column]) for row in rows])
    except ValueError:
        raise UserError(f"{path}: is damaged: a step or a value of {metric} is not a number") from None
