"""Figures as files."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from t2m_jax.config import UserError


def check_json_path(path: Path) -> None:
    """Raises `UserError` where a report could not be written, before the work is done."""
    folder = path.absolute().parent
    if not folder.is_dir():
        raise UserError(f"{path}: the folder {folder} does not exist; make it first")
    if path.is_dir() or not os.access(path if path.exists() else folder, os.W_OK):
        raise UserError(f"{path}: cannot be written")


COLUMNS = {
    "r_precision_1": ("R top-1 ↑", 3),
    "r_precision_2": ("R top-2 ↑", 3),
    "r_precision_3": ("R top-3 ↑", 3),
    "fid": ("FID ↓", 3),
    "matching_score": ("MM-Dist ↓", 3),
    "diversity": ("Diversity →", 3),
    "multimodality": ("MModality ↑", 3),
}
"""Metrics of the field's tables: heading with the better direction (→: as real motion), digits."""


def generation_table(report: Mapping[str, Any]) -> str:
    """Returns the Markdown table of a report as papers print it: mean and half-width of the 95 % interval."""
    lines = ["| | " + " | ".join(heading for heading, _ in COLUMNS.values()) + " |"]
    lines.append("| --- |" + " ---: |" * len(COLUMNS))
    for row, figures in report["rows"].items():
        cells = []
        for metric, (_, digits) in COLUMNS.items():
            found = figures.get(metric)
            cells.append(f"{found['mean']:.{digits}f} ± {found['interval']:.{digits}f}" if found else "")
        lines.append(f"| {row} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def save_json(path: Path, figures: Mapping[str, Any]) -> None:
    """Writes figures as JSON with sorted keys; the file appears whole or not at all."""
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(json.dumps(dict(figures), indent=2, sort_keys=True, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(partial, path)
