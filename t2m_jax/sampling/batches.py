"""Batches of few different shapes, so that few programs are compiled."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import jax
import numpy as np
from jaxtyping import Float, Int

T = TypeVar("T")

CONCURRENT_BATCHES = 2
"""Batches computed at the same time on one device: with one, the cores of a processor often wait for each other."""


class PaddedMotions(NamedTuple):
    """Motions of different lengths in one array."""

    motion: Float[np.ndarray, "B T D"]
    """Zero after the end of each motion."""
    lengths: Int[np.ndarray, " B"]
    """Frames; 0 in rows that fill up the batch."""


def round_up(size: int, multiple: int) -> int:
    """Returns the smallest multiple that is not below `size`."""
    return -(-size // multiple) * multiple


def padded_batch_size(count: int) -> int:
    """Returns the smallest power of two that is not below `count`."""
    # Of the number below, so that a power of two stays as it is.
    return 1 << (count - 1).bit_length()


def fill_up(items: Sequence[T]) -> list[T]:
    """Returns the items of a batch, filled up with the first one to a power of two."""
    # So that few programs are compiled.
    return [*items, *[items[0]] * (padded_batch_size(len(items)) - len(items))]


def pad_motions(motions: Sequence[Float[np.ndarray, "_ D"]], *, batch: int, size: int) -> PaddedMotions:
    """Returns at most `batch` motions in an array of `batch` rows and `size` frames."""
    padded = np.zeros((batch, size, motions[0].shape[1]), np.float32)
    for row, motion in enumerate(motions):
        padded[row, : len(motion)] = motion
    lengths = np.array([len(motion) for motion in motions], np.int32)
    return PaddedMotions(padded, np.pad(lengths, (0, batch - len(motions))))


def batches_of(rows: Int[np.ndarray, " N"], size: int) -> list[Int[np.ndarray, " B"]]:
    """Returns the rows in batches of one size; the last batch is filled up with its own rows, repeated."""
    return [np.resize(rows[first : first + size], size) for first in range(0, len(rows), size)]


def for_each_batch(work: Callable[[Int[np.ndarray, " B"]], None], batches: Iterable[Int[np.ndarray, " B"]]) -> None:
    """Calls `work` with each batch in several threads; each call must write to places of its own."""
    # On several devices, each batch is divided among all of them. They could wait for each other forever.
    with ThreadPoolExecutor(CONCURRENT_BATCHES if jax.local_device_count() == 1 else 1) as threads:
        list(threads.map(work, batches))  # raises the errors of the threads
