"""Signals that end a training after the next update, so that no update is lost."""

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

import jax
from jax.experimental import multihost_utils

from t2m_jax.errors import ENDING_SIGNALS


@contextlib.contextmanager
def stop_requests() -> Iterator[Callable[[int], int | None]]:
    """Yields a function that says, after an update, whether a signal asked to stop.

    From the number of updates, it returns the number of the signal, or None. If several processes train together, it
    gives all of them the same answer after the same update. A second Ctrl-C interrupts at once.
    """
    found: list[int] = []

    def remember(number: int, _: FrameType | None) -> None:
        if number == signal.SIGINT and found:
            raise KeyboardInterrupt
        found.append(number)

    def pass_on(number: int, _: FrameType | None) -> None:
        os.kill(os.getpid(), signal.SIGTERM)

    several = jax.process_count() > 1
    # With several processes, JAX has a handler of SIGTERM of its own, through which they agree on a step.
    handlers = {"SIGUSR1": pass_on} if several else dict.fromkeys(ENDING_SIGNALS, remember)
    if threading.current_thread() is not threading.main_thread():
        handlers = {}  # only the main thread may have handlers
    numbers = {getattr(signal, name): handler for name, handler in handlers.items() if hasattr(signal, name)}
    before = {number: signal.signal(number, handler) or signal.SIG_DFL for number, handler in numbers.items()}

    def asked(step: int) -> int | None:
        if several:
            return signal.SIGTERM if multihost_utils.reached_preemption_sync_point(step) else None
        return found[0] if found else None

    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
