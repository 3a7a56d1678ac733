"""Say what is intact: `t2m check PATH` compares files with their checksums, and reads them.

PATH is a run, a bundle, an evaluator, a data set, or a report of `t2m evaluate --json` or `t2m bench --json`. The exit
code is not 0 if something is damaged.
"""

import argparse
import sys
from pathlib import Path

from t2m_jax.errors import UserError, printable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    parser.add_argument("path", help="run, bundle, evaluator, name of a packaged one, data set, or report (.json)")


def run(args: argparse.Namespace) -> None:
    """Prints a line for each part."""
    from t2m_jax.checkpoints.bundle import bundle_path
    from t2m_jax.checkpoints.evaluator import evaluator_path

    path = evaluator_path(bundle_path(args.path))
    if path.is_file():
        sys.stdout.write(printable(f"{path}: intact, {_describe_report(path)}") + "\n")
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
        sys.stdout.write(printable(f"{part.name}: {part.problem or 'intact'}") + "\n")
    # For scripts. It is no user error: the report above is what was asked for.
    if any(part.problem for part in parts):
        sys.exit(1)


def _describe_report(path: Path) -> str:
    """Returns which command wrote a report and what is in it, after all of it has been read.

    Raises:
        UserError: It is damaged, or is not a report.
    """
    from t2m_jax.evaluation.prompts.results import load_prompt_report
    from t2m_jax.evaluation.report.record import load_reconstruction, load_report
    from t2m_jax.files.reading import load_json
    from t2m_jax.motion.formats import motion_formats

    if path.suffix.lower().removeprefix(".") in motion_formats():
        raise UserError(f"{path}: is a file of motions, which has no checksum; `t2m view` reads those with a skeleton")
    data = load_json(path)
    found = set(data) if isinstance(data, dict) else set()
    if found & {"machine", "format_version"}:
        from t2m_jax import bench

        return f"a report of `t2m bench` (rows: {len(bench.load_report(path).rows)})"
    if "rows" in found:  # before the next question: its header may have `contents`, a fingerprint of the data
        report = load_report(path)
        command = "generation`" if report.kind == "generated" else "reconstruction` with an evaluator,"
        return f"a report of `t2m evaluate {command} on {report.header.num_samples} motions"
    if found & {"prompt_following", "contents"}:
        prompts = load_prompt_report(path)
        return f"a report of `t2m evaluate prompts --group {prompts.group}` on {prompts.num_samples} motions"
    if "mpjpe_mm" in found:
        return f"a report of `t2m evaluate reconstruction` on {load_reconstruction(path).num_clips} clips"
    raise UserError(f"{path}: is not a report; give a file that `t2m evaluate --json` or `t2m bench --json` wrote")
