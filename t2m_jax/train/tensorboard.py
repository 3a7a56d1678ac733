"""Values and pictures of a run for TensorBoard."""

import contextlib
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from tensorboardX import summary
from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event, SessionLog

from t2m_jax.files.writing import writing


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
