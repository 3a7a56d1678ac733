"""The exceptions that end a command with one line, and text that is safe to print."""

import signal


def printable(text: str) -> str:
    """Returns a text with escapes in place of characters that could move the cursor or break the line."""
    return "".join(character if character.isprintable() else repr(character)[1:-1] for character in text)


class UserError(ValueError):
    """A mistake that the user can correct.

    The message is one line. It names the file, field or value, says what is wrong, and says what to do.
    """


class Interruption(KeyboardInterrupt):
    """A signal asked the process to end. The message is one line that says what was kept."""

    def __init__(self, number: int, message: str = ""):
        """Takes the number of the signal."""
        super().__init__(message or f"interrupted by {signal.Signals(number).name}")
        self.number = number
