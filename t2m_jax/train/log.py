"""Metrics of a run, in CSV files, TensorBoard and the program's log."""

import contextlib
import csv
import logging
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float, UInt8
from PIL import Image
from tensorboardX import summary
from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event, SessionLog

from t2m_jax.distributed import is_writer
from t2m_jax.files.reading import load_bytes
from t2m_jax.files.writing import atomic_file, save_text, writing

logger = logging.getLogger(__name__)

PICTURES = "pictures"
"""Folder of a run with pictures of its motions."""


def by_depth(name: str, values: Float[Array, " R"]) -> dict[str, Float[Array, ""]]:
    """Returns a metric of every depth by its name in logs: `name/1` to `name/R`, in an order that sorting keeps."""
    # Leading zeros, because TensorBoard sorts names as text.
    digits = len(str(len(values)))
    return {f"{name}/{depth:0{digits}d}": value for depth, value in enumerate(values, start=1)}


class Board:
    """A file of events. `SummaryWriter` writes in a thread, which waits forever after the disk was full."""

    def __init__(self, folder: Path, *, first_step: int):
        """Opens a new file in a folder. TensorBoard then hides what older files have after `first_step`."""
        self._folder = folder
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            self._events = EventsWriter(str(folder / "events"))
        # The files of a run that stopped may have events of steps that are computed again.
        if first_step:
            self._write(Event(step=first_step + 1, session_log=SessionLog(status=SessionLog.START)))

    def close(self) -> None:
        """Closes the file. All events are in it already."""
        with contextlib.suppress(OSError):  # of a full disk, which the write has reported
            self._events.close()

    def add_values(self, step: int, values: Mapping[str, float]) -> None:
        """Adds values by their names."""
        self._write(*(Event(step=step, summary=summary.scalar(name, value)) for name, value in values.items()))

    def add_picture(self, step: int, name: str, picture: UInt8[np.ndarray, "H W 3"]) -> None:
        """Adds a picture."""
        self._write(Event(step=step, summary=summary.image(name, picture, dataformats="HWC")))

    def _write(self, *events: Any) -> None:
        with writing(self._folder):
            for event in events:
                event.wall_time = time.time()
                self._events.write_event(event)
            self._events.flush()  # so that a crash loses nothing, and a full disk is noticed here


class MetricLog:
    """Writes rows of metrics. After a resume the files continue as if the run had never stopped.

    Of several processes that train together, only one writes. The logs of the others do nothing.
    """

    def __init__(self, run: Path, *, first_step: int):
        """Opens the log of a run; rows after `first_step` are removed when a file is first written to."""
        self._run = run
        self._first_step = first_step
        self._columns: dict[str, list[str]] = {}
        self._board = Board(run / "tensorboard", first_step=first_step) if is_writer() else None
        self._last_row = time.perf_counter()

    def __enter__(self) -> "MetricLog":
        return self

    def __exit__(self, *error: object) -> None:
        if self._board is not None:
            self._board.close()

    def write(self, split: str, step: int, metrics: Mapping[str, float], *, title: str) -> None:
        """Adds one row to `<split>.csv`, to TensorBoard and to the log."""
        if self._board is None:
            return
        path = self._run / f"{split}.csv"
        if split not in self._columns:
            self._columns[split] = _keep_rows(path, self._first_step) or ["step", *metrics]
        is_new = not path.exists()
        with writing(path), path.open("a", newline="", encoding="utf-8") as file:
            # A run of an earlier version may lack columns of today. Its files keep their own columns.
            writer = csv.DictWriter(file, self._columns[split], extrasaction="ignore", lineterminator="\n")
            if is_new:
                writer.writeheader()
            # repr keeps every bit of a float.
            writer.writerow({"step": step} | {name: repr(value) for name, value in metrics.items()})
        self._show(split, step, metrics, title=title)

    def write_speed(self, step: int, *, steps: int, frames_per_step: int | float) -> None:
        """Adds the speed of the last `steps` updates to TensorBoard and the log, which need not be reproducible."""
        rate = steps / (time.perf_counter() - self._last_row)
        speed = {"steps_per_second": rate, "frames_per_second": rate * frames_per_step}
        self._show("speed", step, speed, title="speed")

    def restart_clock(self) -> None:
        """Starts to measure the speed: updates count from now on."""
        self._last_row = time.perf_counter()

    def write_picture(self, step: int, picture: UInt8[np.ndarray, "H W 3"]) -> None:
        """Adds a picture of motions to TensorBoard, and a PNG file to the run."""
        if self._board is None:
            return
        # Files of their own, because few people look for pictures in TensorBoard.
        folder = self._run / PICTURES
        folder.mkdir(exist_ok=True)
        with atomic_file(folder / f"{step}.png") as partial:
            Image.fromarray(picture).save(partial)
        self._board.add_picture(step, "motion", picture)

    def _show(self, split: str, step: int, metrics: Mapping[str, float], *, title: str) -> None:
        if self._board is None:
            return
        self._board.add_values(step, {f"{split}/{name}": value for name, value in metrics.items()})
        # There are too many metrics of single depths for a line.
        words = ", ".join(f"{name} {value:.4g}" for name, value in metrics.items() if "/" not in name)
        logger.info("step %d, %s: %s", step, title, words)


def _keep_rows(path: Path, last_step: int) -> list[str]:
    """Removes rows after `last_step` and damaged ones; returns the columns, none for a new file.

    A file without a header that can be read is set aside: it must not keep a run from going on.
    """
    if not path.exists():
        return []
    header, *rows = whole_lines(path)
    if header and not (header.startswith("step,") and header.isascii()):
        aside = path.with_name(f"{path.name}.damaged")
        logger.warning("%s: its header is damaged; it is set aside as %s", path, aside.name)
        path.replace(aside)
        return []
    kept = [row for row in rows if int(row.partition(",")[0]) <= last_step]
    # Without rows, the columns of today are better than old ones.
    if not kept:
        path.unlink()
        return []
    save_text(path, "".join([header, *kept]))
    return header.strip().split(",")


def whole_lines(path: Path) -> list[str]:
    """Returns the header of a log, empty if it has none, and the rows that have a step and all cells.

    A crash or a full disk may have cut the last row.

    Raises:
        UserError: The file cannot be read.
    """
    header, *lines = load_bytes(path).decode(errors="replace").splitlines(keepends=True) or [""]
    rows = [line for line in lines if line.isascii() and line.endswith("\n") and line.count(",") == header.count(",")]
    steps = [row.partition(",")[0] for row in rows]
    return [header, *(row for row, step in zip(rows, steps, strict=True) if step.isdecimal() and len(step) < 20)]
