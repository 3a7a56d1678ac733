"""Sub-commands of a command, each run by a function of its module."""

import argparse
from collections.abc import Callable

Run = Callable[[argparse.Namespace], None]


def subcommand_adder(parser: argparse.ArgumentParser) -> Callable[[Run, str], argparse.ArgumentParser]:
    """Returns a function that adds a sub-command `x` for a function `run_x` and its help, and returns its parser.

    The parsed arguments have the function as `run_command`.
    """
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=type(parser))

    def add(function: Run, help_: str) -> argparse.ArgumentParser:
        name, description = function.__name__.removeprefix("run_"), f"{help_[0].upper()}{help_[1:]}."
        command = commands.add_parser(name, help=help_, description=description, allow_abbrev=False)
        command.set_defaults(run_command=function)
        return command

    return add
