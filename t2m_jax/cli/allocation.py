"""How a command that trains gets memory from the system."""

import ctypes
import sys

OPTIONS = {"M_ARENA_MAX": (-8, 1), "M_MMAP_MAX": (-4, 0), "M_TRIM_THRESHOLD": (-1, -1)}
"""Options of glibc's `mallopt(3)`, each with its number: one heap, nothing outside it, and nothing is given back."""


def keep_freed_memory() -> None:
    """Makes this process keep memory that it frees, for its next arrays; without glibc, nothing changes.

    On a CPU, an update takes and frees memory for its intermediate values. Memory from the system comes in pages that
    have to be cleared first, which takes 10 to 20 % of the processor time (docs/performance.md).
    """
    # The threads of JAX have heaps of their own, which nothing changes any more.
    if sys.platform != "linux" or "jax" in sys.modules:
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for option, value in OPTIONS.values():
            mallopt(option, value)
