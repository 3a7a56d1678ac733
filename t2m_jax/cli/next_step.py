"""The last line of a command: what users run next."""

import sys

from t2m_jax.errors import printable


def show_next(command: str) -> None:
    """Prints the next command on standard error, so that standard output stays easy to parse."""
    sys.stderr.write(f"next: {printable(command)}\n")
