"""What `t2m evaluate` shows: tables of one report or several, and the page of one. No command of its own."""

import argparse
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from t2m_jax.evaluation.sources import Maker
    from t2m_jax.evaluation.task import Subject

FORMATS = ("terminal", "markdown", "latex", "json")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of tables and pages."""
    parser.add_argument("--format", choices=FORMATS, default="terminal", help="how to print (table)")
    parser.add_argument("--names", nargs="+", default=None, metavar="NAME", help="of the rows; else the files' (table)")
    parser.add_argument(
        "--by-label", action="store_true", help="R-precision that takes a label's motions as one (table)"
    )
    parser.add_argument("--html", default=None, metavar="F", help="also write a page with plots and motions")


def check_options(args: argparse.Namespace) -> None:
    """Raises `UserError` where the page could not be made, before the work is done."""
    from t2m_jax.errors import UserError
    from t2m_jax.evaluation.report.page import check_page

    if args.what == "prompts" or args.evaluator is None:
        raise UserError(f"evaluate {args.what}: --html shows motion as an evaluator sees it; use it with --evaluator")
    check_page(Path(args.html))


def print_report(report: Mapping[str, Any]) -> None:
    """Prints the table of one report, below what the report is of."""
    from t2m_jax.evaluation.report.formats import format_table
    from t2m_jax.evaluation.report.tables import make_table

    (name,) = report["rows"].keys() - {"real"}
    table = make_table([report], [name])._replace(facts={})
    sys.stdout.write(format_table(table, style="terminal") + "\n")


def run_table(args: argparse.Namespace) -> None:
    """Prints the table of the reports that are named.

    Raises:
        UserError: if they are no reports, do not compare, or their names are not one each.
    """
    from t2m_jax.errors import UserError
    from t2m_jax.evaluation.report.formats import format_table
    from t2m_jax.evaluation.report.record import load_report
    from t2m_jax.evaluation.report.tables import make_table

    if not args.reports:
        raise UserError("evaluate table: give the reports, as `t2m evaluate generation --json` writes them")
    paths = [Path(path) for path in args.reports]
    stems = [path.stem for path in paths]
    names = args.names or (stems if len(set(stems)) == len(stems) else args.reports)
    table = make_table([load_report(path) for path in paths], names, by_label=args.by_label)
    color = sys.stdout.isatty() and "NO_COLOR" not in os.environ
    sys.stdout.write(format_table(table, style=args.format, color=color) + "\n")


def write_page(path: Path, report: Mapping[str, Any], subject: "Subject", maker: "Maker") -> None:
    """Writes the page of a report; subject and maker are those it was made with."""
    import functools

    from t2m_jax.evaluation.report.details import gather_evidence
    from t2m_jax.evaluation.report.page import save_page
    from t2m_jax.export import viewer_html

    evidence = gather_evidence(subject, maker)
    save_page(path, report, evidence, viewer=functools.partial(viewer_html, embed=False))
