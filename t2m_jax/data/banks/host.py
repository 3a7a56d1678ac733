"""Motions that stay on the host: threads cut the windows of the next steps, and the devices get only these.

Windows are those that a bank on the devices would give, because the same functions of key and step choose them.
"""

import contextlib
import mmap
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from t2m_jax.data.banks.motions import Cuts, banks_of, map_banks, without_frames
from t2m_jax.errors import UserError

NUM_THREADS = 4
"""Threads that cut windows. Two are enough to copy from memory; more wait for a disk."""


class FeedPlan(NamedTuple):
    """What the host needs to know to cut the windows of a training."""

    cuts: Callable[[Any, Int[Array, ""]], Cuts]
    """From data and a step to the cuts of its batch. It must be traceable by `jax.jit` and must not read frames."""
    window: int
    """Frames of a window."""


class HostWindows:
    """The windows of the steps of a training, cut from frames on the host."""

    def __init__(self, data: Any, plan: FeedPlan, *, rows: Int[np.ndarray, " R"]):
        """Takes a bank of motions, or data that contain one.

        Args:
            data: As NumPy arrays. The frames may be mapped into memory.
            plan: Where its windows are cut.
            rows: The rows of each batch that this process needs.

        Raises:
            UserError: JAX may not use the CPU.
        """
        try:
            cpu = jax.local_devices(backend="cpu")[0]
        except RuntimeError as error:
            words = "placement: data on the host need JAX's CPU backend; add `,cpu` to JAX_PLATFORMS, or unset it"
            raise UserError(words) from error
        (bank,) = banks_of(data)
        self._frames = np.asarray(bank.frames)
        self._window = plan.window
        self._rows = rows
        # Whatever the training runs on, the host needs the numbers at once.
        self._data = jax.device_put(map_banks(data, without_frames), cpu)
        self._first_rows = jax.jit(lambda data, step: plan.cuts(data, step).first_rows)

    def cut(self, step: int) -> Float[np.ndarray, "R T D"]:
        """Returns the raw windows of a step. Rows after the end of the frames are 0; no window uses them."""
        first_rows = np.asarray(self._first_rows(self._data, np.int32(step)))[self._rows]
        windows = np.zeros((len(first_rows), self._window, self._frames.shape[1]), np.float32)
        for window, first in zip(windows, first_rows, strict=True):
            # A slice reads only these pages of a file that may be larger than the memory.
            part = self._frames[first : first + self._window]
            window[: len(part)] = part
        release_pages(self._frames)
        return windows

    @contextlib.contextmanager
    def read(self, first_step: int, stop: int, *, ahead: int) -> Iterator[Iterator[Float[np.ndarray, "R T D"]]]:
        """Yields an iterator over the windows of the steps from `first_step` to before `stop`.

        Threads cut the windows of the next `ahead` steps, and one more for each thread, in the meantime.
        """
        import grain  # here, because only data on the host need it

        # Each thread holds one batch beside those that are ready.
        options = grain.ReadOptions(num_threads=NUM_THREADS, prefetch_buffer_size=ahead + NUM_THREADS)
        steps = iter(grain.MapDataset.range(first_step, stop).map(self.cut).to_iter_dataset(options))
        try:
            yield steps
        finally:
            steps.close()


def release_pages(array: np.ndarray) -> None:  # any shape
    """Lets go of what this process has read of a mapped file, which would count as its memory.

    The pages stay in the system's cache, which gives them up when memory is needed. Arrays in memory do not change.
    """
    owner = array
    while isinstance(owner.base, np.ndarray):
        owner = owner.base
    # A map that was opened for writing could lose what was written. Windows has no `madvise`.
    if isinstance(owner.base, mmap.mmap) and not owner.flags.writeable and hasattr(mmap, "MADV_DONTNEED"):
        owner.base.madvise(mmap.MADV_DONTNEED)
