"""Scripts with which a shell completes commands, options and names of files."""

import argparse
import importlib
from collections.abc import Mapping

SHELLS = ("bash", "zsh", "tcsh")


def completion_script(commands: Mapping[str, str], shell: str) -> str:
    """Returns the script of a shell for the program `t2m`.

    Args:
        commands: Names of the modules of commands, with their help.
        shell: One of `SHELLS`.
    """
    import shtab

    parser = argparse.ArgumentParser(prog="t2m")
    children = parser.add_subparsers(dest="command")
    for name, help_ in commands.items():
        module = importlib.import_module(f"t2m_jax.cli.{name}")
        has_help = not getattr(module, "TAKES_CONFIG_OPTIONS", False)
        child = children.add_parser(name, help=help_, add_help=has_help)
        module.add_arguments(child)
        _complete_files(child, shtab.FILE)
    return str(shtab.complete(parser, shell))


def _complete_files(parser: argparse.ArgumentParser, files: Mapping[str, str]) -> None:
    """Completes names of files where a parser, or one of its sub-commands, takes words of any kind."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for child in action.choices.values():
                _complete_files(child, files)
        elif action.nargs != 0 and action.choices is None and action.type not in (int, float):
            action.complete = files  # type: ignore[attr-defined]
