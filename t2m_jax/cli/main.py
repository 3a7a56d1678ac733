"""The program `t2m`: finds the command, runs it, and turns what goes wrong into one line and an exit code.

A command is a module of this package with two functions: `add_arguments(parser)` and `run(args)`. It imports what is
heavy inside `run`, so that help and refusals come at once. A module with `TAKES_CONFIG_OPTIONS = True` finds options
that its parser does not know in `args.config_options`, for `t2m_jax.config.override_config`, and adds a `--help` of its
own that tells about them.
"""

import argparse
import difflib
import importlib
import importlib.metadata
import logging
import os
import sys
import traceback
import typing
import warnings
from collections.abc import Sequence
from types import ModuleType

from t2m_jax.errors import UserError

COMMANDS = {
    "generate": "turn sentences into motion files",
    "data": "import data sets and check them",
    "train": "train a model from a config file",
    "evaluate": "measure a model against data",
    "bundle": "pack run folders into one model to share",
    "convert": "turn published weights into a model, and back",
    "view": "turn any motion file into any other format",
    "bench": "measure speed",
}
"""Commands in the order of use, each with what it does; the module has the command's name."""

QUIET_LIBRARIES = ("absl", "etils", "flax", "jax", "orbax", "tensorstore")
"""Libraries whose warnings are not about the user's doings: only their errors are shown."""

EXIT_OK, EXIT_BUG, EXIT_USER_ERROR, EXIT_INTERRUPTED, EXIT_BROKEN_PIPE = 0, 1, 2, 130, 141


def main(argv: Sequence[str] | None = None) -> int:
    """Returns the exit code of one run of `t2m`: 0, or 2 for a mistake of the user, told in one line."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    arguments, debug = _without_debug(arguments)
    _quieten_libraries(debug)
    try:
        code = _run(arguments)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader (`| head`) has left. Python would complain once more when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except KeyboardInterrupt:
        return _told("interrupted", EXIT_INTERRUPTED, debug)
    except UserError as error:
        return _told(str(error), EXIT_USER_ERROR, debug)
    except OSError as error:
        return _told(_text_from_os_error(error), EXIT_USER_ERROR, debug)
    return code


class _Parser(argparse.ArgumentParser):
    """A parser whose refusals are user errors of one line, without the usage block."""

    def error(self, message: str) -> typing.NoReturn:
        """Raises the refusal; `main` prints it."""
        command = self.prog.partition(" ")[2]
        raise UserError(f"{command}: {message} (see `{self.prog} --help`)" if command else message)


def _run(arguments: list[str]) -> int:
    """Returns the exit code of the command that the arguments name."""
    try:
        if not arguments or arguments[0].startswith("-"):
            return _answer_without_command(arguments)
        name, *rest = arguments
        if name not in COMMANDS:
            near = difflib.get_close_matches(name, COMMANDS, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(COMMANDS)}"
            raise UserError(f"unknown command '{name}'; {hint}")
        module = importlib.import_module(f"t2m_jax.cli.{name}")
        module.run(_parse(module, name, rest))
    except SystemExit as exit_:  # argparse and tyro end so after --help
        return exit_.code if isinstance(exit_.code, int) else EXIT_OK
    return EXIT_OK


def _answer_without_command(arguments: list[str]) -> int:
    """Returns 0 after printing help or the version."""
    width = max(map(len, COMMANDS))
    parser = _Parser(
        prog="t2m",
        usage="t2m [--help] [--version] [--debug] COMMAND ...",
        description="Text to human motion: a sentence in, a moving figure out.",
        epilog="commands:\n"
        + "\n".join(f"  {name:{width}}  {help_}" for name, help_ in COMMANDS.items())
        + "\n\n`t2m COMMAND --help` tells more about each.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    version = f"t2m_jax {importlib.metadata.version('t2m-jax')}"
    parser.add_argument("--version", action="version", version=version, help="show the version and exit")
    parser.add_argument("--debug", action="store_true", help="show tracebacks and the libraries' warnings")
    parser.parse_args(arguments)
    parser.print_help()
    return EXIT_OK


def _parse(module: ModuleType, name: str, arguments: list[str]) -> argparse.Namespace:
    """Returns the parsed arguments of a command."""
    takes_config_options = getattr(module, "TAKES_CONFIG_OPTIONS", False)
    parser = _Parser(
        prog=f"t2m {name}", description=module.__doc__, allow_abbrev=False, add_help=not takes_config_options
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    module.add_arguments(parser)
    args, unknown = parser.parse_known_args(arguments)
    if takes_config_options:
        args.config_options = unknown
    elif unknown:
        near = difflib.get_close_matches(unknown[0].partition("=")[0], _options(parser), n=1)
        parser.error(f"unknown argument '{unknown[0]}'" + (f"; did you mean '{near[0]}'?" if near else ""))
    return args


def _options(parser: argparse.ArgumentParser) -> list[str]:
    """Returns the options of a parser and of the sub-commands below it."""
    options: list[str] = []
    for action in parser._actions:
        options += action.option_strings
        if isinstance(action, argparse._SubParsersAction):
            options += [option for below in action.choices.values() for option in _options(below)]
    return options


def _without_debug(arguments: list[str]) -> tuple[list[str], bool]:
    """Returns the arguments less `--debug`, which may stand anywhere before a `--`, and whether it was there."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    kept = [argument for argument in arguments[:end] if argument != "--debug"]
    return kept + arguments[end:], len(kept) < end


def _quieten_libraries(debug: bool) -> None:
    """Sends the project's own notes to standard error as plain lines and drops what libraries only remark."""
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    if debug:
        return
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")  # XLA's own log, read when jax is imported
    for handler in logging.getLogger().handlers:
        handler.addFilter(_is_worth_showing)
    for library in QUIET_LIBRARIES:
        warnings.filterwarnings("ignore", module=rf"{library}(\.|$)")


def _is_worth_showing(record: logging.LogRecord) -> bool:
    """Returns whether a log record is the project's own, or an error."""
    # A filter rather than logger levels: absl installs its own logger class, which an early `getLogger` would prevent.
    return record.levelno >= logging.ERROR or record.name.partition(".")[0] not in QUIET_LIBRARIES


def _text_from_os_error(error: OSError) -> str:
    """Returns what the system refused, file first."""
    reason = (error.strerror or str(error)).rstrip(".")
    return f"{error.filename}: {reason}" if error.filename is not None else reason


def _told(message: str, code: int, debug: bool) -> int:
    """Returns the exit code after printing the one line (and the traceback when debugging)."""
    if debug:
        traceback.print_exc()
    line = " ".join(message.split())
    # Texts of the user may be quoted in it: nothing may move the cursor or break the line.
    line = "".join(character if character.isprintable() else repr(character)[1:-1] for character in line)
    sys.stderr.write(f"t2m: error: {line}\n")
    return code
