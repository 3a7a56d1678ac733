"""Rows in batches of one size, two of them at work at a time."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Int

AT_A_TIME = 2
"""Batches at work: a single one leaves a processor's cores waiting for each other."""


def batches_of(rows: Int[np.ndarray, " N"], size: int) -> list[Int[np.ndarray, " B"]]:
    """Returns the rows in batches of one size; the last is filled up with its own rows, repeated."""
    return [np.resize(rows[first : first + size], size) for first in range(0, len(rows), size)]


def for_each_batch(work: Callable[[Int[np.ndarray, " B"]], None], batches: Iterable[Int[np.ndarray, " B"]]) -> None:
    """Calls `work` with each batch, two at a time; what it writes must be the batch's own."""
    with ThreadPoolExecutor(AT_A_TIME) as threads:
        for _ in threads.map(work, batches):
            pass
