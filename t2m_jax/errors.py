"""The exceptions that end a command with one line, and text that is safe to print."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from types import FrameType

MAX_LINE = 380
"""Characters of the longest message; a longer one quotes a long text of a file, or a long list. A line that begins with
`t2m: error:` has at most 400."""
GAP = " ... "
OUT_OF_MEMORY = ("RESOURCE_EXHAUSTED", "std::bad_alloc", "can't start new thread", "[Errno 12]")
"""Begins the texts of the errors of XLA, C++, Python and the system for memory that is full."""
ENDING_SIGNALS = ("SIGINT", "SIGTERM", "SIGUSR1")
"""Ctrl-C, the end of a cluster's job, and the notice that a machine is taken away; Windows has no SIGUSR1."""


def printable(text: str) -> str:
    """Returns a text with escapes in place of characters that could move the cursor or break the line."""
    return "".join(character if character.isprintable() else repr(character)[1:-1] for character in text)


def one_line(text: str) -> str:
    """Returns a text as one printable line; if it is too long, its middle is left out."""
    line = printable(" ".join(text.splitlines()))
    half = (MAX_LINE - len(GAP)) // 2
    if len(line) <= MAX_LINE:
        return line
    # Between words, if there are any.
    return f"{line[:half].rpartition(' ')[0] or line[:half]}{GAP}{line[-half:].partition(' ')[2] or line[-half:]}"


class UserError(ValueError):
    """A mistake that the user can correct.

    The message is one line. It names the file, field or value, says what is wrong, and says what to do.
    """

    def __init__(self, message: str):
        """Takes the message, which may quote text of the user."""
        super().__init__(one_line(message))


@contextlib.contextmanager
def naming(place: object) -> Iterator[None]:
    """Adds the name of a file, or of a part of it, to the mistakes that a block finds there."""
    try:
        yield
    except UserError as error:
        raise UserError(f"{place}: {error}") from error


@contextlib.contextmanager
def handling_signals(handlers: Mapping[str, Callable[[int, FrameType | None], None]]) -> Iterator[None]:
    """Handles signals by name in a block. Names that the system does not have are left out.

    Only the main thread may have handlers, so nothing happens in others.
    """
    if threading.current_thread() is not threading.main_thread():
        handlers = {}
    numbers = {getattr(signal, name): handler for name, handler in handlers.items() if hasattr(signal, name)}
    before = {number: signal.signal(number, handler) or signal.SIG_DFL for number, handler in numbers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Interruption(KeyboardInterrupt):
    """A signal asked the process to end. The message is one line that says what was kept."""

    def __init__(self, number: int, message: str = ""):
        """Takes the number of the signal."""
        super().__init__(message or f"interrupted by {signal.Signals(number).name}")
        self.number = number


def is_out_of_memory(error: BaseException) -> bool:
    """Returns whether an error, or one that led to it, says that the memory of the machine or of a device is full."""
    found: BaseException | None = error
    while found is not None:
        # By the text: the class of XLA's errors is that of all of its faults.
        if isinstance(found, MemoryError) or str(found).startswith(OUT_OF_MEMORY):
            return True
        found = found.__cause__ or (None if found.__suppress_context__ else found.__context__)
    return False
