"""Say what is intact: `t2m check PATH` compares files with their checksums, and reads them.

PATH is a run, a bundle, an evaluator, a data set, or the report of an evaluation. The exit code is 1 if something is
damaged.
"""

import argparse
import sys

from t2m_jax.errors import UserError, printable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    parser.add_argument("path", help="run, bundle, bundled name, evaluator, data set, or report (.json)")


def run(args: argparse.Namespace) -> None:
    """Prints a line for each part."""
    from t2m_jax.checkpoints.bundle import bundle_path

    path = bundle_path(args.path)
    if path.is_file():
        from t2m_jax.evaluation.report import load_report

        load_report(path)
        sys.stdout.write(f"{path}: the report is intact\n")
        return
    if not path.is_dir():
        raise UserError(f"{path}: there is no such file or folder")
    from t2m_jax.checkpoints.audit import audit_model, is_model_folder

    if not is_model_folder(path):
        from t2m_jax.cli.data import check_dataset

        check_dataset(path, None)
        return
    parts = audit_model(path)
    for part in parts:
        without = "" if part.has_manifest else " (it has no checksums, because an older version wrote it)"
        sys.stdout.write(printable(f"{part.name}: {part.problem or f'intact{without}'}") + "\n")
    if any(part.problem for part in parts):
        sys.exit(1)
