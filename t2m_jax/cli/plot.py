"""Draw the loss curves of runs in one figure: `t2m plot runs/a runs/b -o curves.png`.

Each run has a color. Its loss in training is pale, and its validation loss strong. `--metric` draws another column of
the files `train.csv`, `val.csv` and `evaluation.csv` of the runs. It needs the extra `plot`.
"""

import argparse
import sys
from pathlib import Path

from t2m_jax.cli.options import show_next
from t2m_jax.errors import printable


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
    from t2m_jax.train import Run

    check_chart(check_output(args.output))
    curves = {f"{path}": Run(path).curves(args.metric) for path in args.runs}
    save_chart(args.output, curves_chart(curves, metric=args.metric))
    sys.stdout.write(f"{printable(str(args.output))}\n")
    show_next(f"open {args.output}")
