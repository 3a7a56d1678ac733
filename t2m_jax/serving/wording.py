"""Errors in the words of a page: the library says what to type in a terminal, and a browser has none."""

from t2m_jax.errors import UserError

IN_BROWSER = {
    "`t2m data rig FILE` writes the best guess of a table, to be checked and given as --rig": (
        "open it together with a table that says which of its joints are these (.yaml)"
    ),
    "--rig TABLE": "a table of joints (.yaml) that is opened with it",
    "say which with --up z or --up y": "export it with Y up",
    "needs the extra `video`: pip install 't2m-jax[video]'": "is not possible on this server; choose another format",
    "install the package (pip install -e . in a source tree)": "the server is not completely installed",
}
"""What messages of the library say, and what is said instead."""


def in_browser(error: UserError) -> str:
    """Returns a message without commands and options."""
    text = str(error)
    for command, words in IN_BROWSER.items():
        text = text.replace(command, words)
    return text
