"""The last line of a command: what users run next."""

import sys


def show_next(command: str) -> None:
    """Prints the next command on standard error, so that standard output stays easy to parse."""
    sys.stderr.write(f"next: {command}\n")
