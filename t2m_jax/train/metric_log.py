"""Metrics of a run, to CSV and TensorBoard."""

import csv
import os
from collections.abc import Mapping
from pathlib import Path

from tensorboardX import SummaryWriter


class MetricLog:
    """Writes rows of metrics; after a resume the files go on as if the run had never stopped."""

    def __init__(self, run: Path, *, first_step: int):
        """Opens the files of a run and forgets what they hold past `first_step`."""
        self._run = run
        self._first_step = first_step
        self._opened: set[str] = set()
        self._board = SummaryWriter(str(run / "tensorboard"), purge_step=first_step + 1 if first_step else None)

    def write(self, split: str, step: int, metrics: Mapping[str, float]) -> None:
        """Adds one row to `<split>.csv` and to TensorBoard."""
        path = self._run / f"{split}.csv"
        if split not in self._opened:
            _truncate(path, self._first_step)
            self._opened.add(split)
        is_new = not path.exists()
        with path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            if is_new:
                writer.writerow(["step", *metrics])
            # repr keeps every bit of a float.
            writer.writerow([step, *(repr(value) for value in metrics.values())])
        for name, value in metrics.items():
            self._board.add_scalar(f"{split}/{name}", value, step)

    def close(self) -> None:
        """Flushes and closes TensorBoard's file."""
        self._board.close()


def _truncate(path: Path, last_step: int) -> None:
    """Drops rows past `last_step`, and a last row that a crash cut short."""
    if not path.exists():
        return
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    kept = [line for line in lines[1:] if line.endswith("\n") and int(line.split(",")[0]) <= last_step]
    replacement = path.with_suffix(".csv.partial")
    replacement.write_text("".join([*lines[:1], *kept]) if kept else "", encoding="utf-8", newline="\n")
    if kept:
        os.replace(replacement, path)
    else:
        replacement.unlink()
        path.unlink()
