"""What `t2m evaluate` does with reports: `compare` and `table`. No command of its own."""

import argparse
import os
import shlex
import sys
from pathlib import Path

from t2m_jax.errors import UserError

FORMATS = ("terminal", "markdown", "latex", "json")


def add_compare_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `compare`."""
    parser.add_argument("reports", nargs="+", type=Path, metavar="REPORT", help="two files of `--json`")


def add_table_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `table`."""
    parser.add_argument("reports", nargs="+", type=Path, metavar="REPORT", help="files of `--json`")
    parser.add_argument("--format", choices=FORMATS, default="terminal", help="how to print (default: terminal)")
    parser.add_argument("--names", nargs="+", metavar="NAME", help="names of the rows (default: names of the files)")
    parser.add_argument(
        "--by-label", action="store_true", help="R-precision that does not count motions of the same label as errors"
    )


def suggest(command: str) -> None:
    """Prints the next command to run; to standard error, so that tables can be redirected."""
    sys.stderr.write(f"next: {command}\n")


def run_compare(args: argparse.Namespace) -> None:
    """Prints the comparison of two reports."""
    from t2m_jax.evaluation.report import compare_reports, comparison_table, load_report

    if len(args.reports) != 2:
        raise UserError(f"evaluate compare: give two reports, not {len(args.reports)}")
    differences = compare_reports(*map(load_report, args.reports))
    sys.stdout.write(comparison_table([path.stem for path in args.reports], differences) + "\n")
    suggest(shlex.join(["t2m", "evaluate", "table", *map(str, args.reports)]))


def run_table(args: argparse.Namespace) -> None:
    """Prints the table of some reports."""
    from t2m_jax.evaluation.report import format_table, load_report, make_table

    stems = [path.stem for path in args.reports]
    names = args.names or (stems if len(set(stems)) == len(stems) else list(map(str, args.reports)))
    table = make_table([load_report(path) for path in args.reports], names, by_label=args.by_label)
    color = sys.stdout.isatty() and "NO_COLOR" not in os.environ
    sys.stdout.write(format_table(table, style=args.format, color=color) + "\n")
    others = [str(path) for path in args.reports[1:2]] or ["OTHER.json"]
    suggest(shlex.join(["t2m", "evaluate", "compare", str(args.reports[0]), *others]))
