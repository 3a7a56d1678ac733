"""Reports as files: figures as JSON, and whether a file can be written at all."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from t2m_jax.errors import UserError

SAME = ("protocol", "data", "split", "num_samples", "evaluator", "seed")
"""What reports must share, so that their repeats look at the same motions with the same captions."""


def check_output(path: Path) -> None:
    """Raises `UserError` where a report could not be written, before the work is done."""
    folder = path.absolute().parent
    if not folder.is_dir():
        raise UserError(f"{path}: the folder {folder} does not exist; make it first")
    if path.is_dir() or not os.access(path if path.exists() else folder, os.W_OK):
        raise UserError(f"{path}: cannot be written")


def load_report(path: Path) -> dict[str, Any]:
    """Returns a report of `t2m evaluate generation`: what it is of, and the figures of each set of motions.

    Raises:
        UserError: if the file is missing or something else.
    """
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        figures = [figure for row in report["rows"].values() for figure in row.values()]
        rows = report["rows"].keys()
        if {*SAME} <= report.keys() and "real" in rows and len(rows) == 2 and all(map(_is_figure, figures)):
            return report
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, KeyError, AttributeError, TypeError):
        pass
    raise UserError(f"{path}: no report of `t2m evaluate generation --json`")


def _is_figure(found: Mapping[str, Any]) -> bool:
    """Returns whether a metric has a mean, an interval and repeats."""
    return all(isinstance(found[name], int | float) for name in ("mean", "interval")) and len(found["repeats"]) > 0


def save_text(path: Path, text: str) -> None:
    """Writes a text as UTF-8; the file appears whole or not at all."""
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)


def save_json(path: Path, figures: Mapping[str, Any]) -> None:
    """Writes figures as JSON with sorted keys; the file appears whole or not at all."""
    save_text(path, json.dumps(dict(figures), indent=2, sort_keys=True, allow_nan=False) + "\n")
