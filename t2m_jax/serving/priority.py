"""How the processes of the server share the processor."""

import os

NICENESS = 5
"""Of processes that calculate, as the system counts it: they leave the processor to the one that answers."""


def lower_priority() -> None:
    """Lets the process of the server go first, so that it answers at once on a machine with few cores.

    Concerns this thread, and those that it starts. Windows has no such numbers, and nothing changes.
    """
    if hasattr(os, "nice"):
        os.nice(max(NICENESS - os.nice(0), 0))
