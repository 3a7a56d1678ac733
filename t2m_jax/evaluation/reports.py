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


def save_json(path: Path, figures: Mapping[str, Any]) -> None:
    """Writes figures as JSON with sorted keys; the file appears whole or not at all."""
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(json.dumps(dict(figures), indent=2, sort_keys=True, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(partial, path)
