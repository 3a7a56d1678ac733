"""The program `t2m`: runs a command and turns errors into one line and an exit code.

A command is a module of this package with two functions: `add_arguments(parser)` and `run(args)`. Slow imports are
inside `run`, so that help and error messages appear at once. A module with `TAKES_CONFIG_OPTIONS = True` gets the
options that its parser does not know as `args.config_options`, for `t2m_jax.config.override_config`, and must add its
own `--help`.
"""

import argparse
import contextlib
import difflib
import importlib
import importlib.metadata
import io
import logging
import os
import signal
import sys
import traceback
import typing
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from t2m_jax.cli.completion import SHELLS, completion_script
from t2m_jax.errors import (
    ENDING_SIGNALS,
    Interruption,
    UserError,
    handling_signals,
    is_out_of_memory,
    one_line,
    printable,
)

COMMANDS = {
    "generate": "convert text to motion files",
    "data": "import data sets and check them",
    "train": "train a model from a config file",
    "evaluate": "measure the quality of a model on data",
    "benchmark": "measure a model on open data, with a packaged evaluator",
    "teach": "teach a model other words for what it knows",
    "plot": "draw the loss curves of runs in one figure",
    "bundle": "combine runs to one model that can be shared, and push it to the hub",
    "models": "list packaged and downloaded models, and show their cards",
    "convert": "convert published weights to a model, and back",
    "export": "write a model as ONNX graphs or as a web page, which need no Python",
    "view": "convert a motion file to other formats",
    "serve": "open the studio: a page and an HTTP interface",
    "check": "say what is intact in a model, a data set or a report",
    "bench": "measure the speed",
}
"""Commands in the order of use, with their help. The module of a command has its name."""

QUIET_LIBRARIES = (
    "absl",
    "asyncio",
    "etils",
    "flax",
    "httpx",
    "httpx2",
    "huggingface_hub",
    "jax",
    "orbax",
    "tensorstore",
)
"""Libraries whose warnings do not concern the user. Only their errors are shown."""
REPEATING_LOGGERS = ("absl", "asyncio")
"""Loggers of errors that Orbax raises, too: hundreds of lines for a full disk."""

EXIT_OK = 0
EXIT_BUG = 1
EXIT_USER_ERROR = 2
EXIT_BROKEN_PIPE = 141  # 128 and the number of SIGPIPE, as a shell reports it
EXIT_SIGNAL = 128
"""Added to the number of the signal that ended a command: 130 after Ctrl-C, 143 after SIGTERM."""
FIRST_COMMANDS = """
  t2m generate "a person waves" -o wave.html -o wave.bvh
  t2m view wave.bvh -o wave.gif
  t2m models demo
"""
REPORT = "run it again with --debug, and report what that prints"


def main(argv: Sequence[str] | None = None) -> int:
    """Returns the exit code of one run of `t2m`: 0, 2 after a user error, 1 after a bug, or that of a signal.

    Errors are printed as one line.
    """
    for name in ("stdout", "stderr"):  # None if it was closed before the start
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 - until the end of the process
    if isinstance(sys.stdout, io.TextIOWrapper):  # its encoding, that of the system, may lack characters
        sys.stdout.reconfigure(errors="backslashreplace")
    arguments = list(sys.argv[1:] if argv is None else argv)
    # `--debug` may be anywhere before `--`.
    end = arguments.index("--") if "--" in arguments else len(arguments)
    options = [argument for argument in arguments[:end] if argument != "--debug"]
    debug = len(options) < end
    _configure_logging(debug)
    if not debug:
        # Orbax reports one unreadable file with many stack traces from its threads.
        sys.unraisablehook = lambda _: None
    try:
        code = _run(options + arguments[end:])
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        # The reader (`| head`) has closed the pipe. Without this, Python would fail again when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 - whatever it is, users get one line
        if debug:
            traceback.print_exc()
        message, code = _explain(error)
        sys.stderr.write(f"t2m: error: {one_line(message)}\n")
        return code


def _explain(error: BaseException) -> tuple[str, int]:
    """Returns the message and the exit code for what ended a command."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, KeyboardInterrupt):
        cause = cause.__cause__ or cause.__context__
    error = cause or error  # Orbax turns an interruption into an error of its own
    if isinstance(error, KeyboardInterrupt):
        return str(error) or "interrupted", EXIT_SIGNAL + getattr(error, "number", signal.SIGINT)
    if isinstance(error, UserError):
        return str(error), EXIT_USER_ERROR
    if is_out_of_memory(error):
        return "out of memory; give fewer or smaller inputs at once", EXIT_USER_ERROR
    if isinstance(error, OSError):
        reason = (error.strerror or str(error)).rstrip(".")
        return (f"{error.filename}: {reason}" if error.filename is not None else reason), EXIT_USER_ERROR
    last = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(last.filename).name}:{last.lineno}"
    return f"{type(error).__name__} in {place}: {error} (a bug of t2m_jax: {REPORT})", EXIT_BUG


def _ended_by_signals() -> contextlib.AbstractContextManager[None]:
    """Turns signals into an exception in a block, as Python does with Ctrl-C, so that temporary files are removed."""

    def interrupt(number: int, _: FrameType | None) -> None:
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        signal.signal(number, signal.SIG_IGN)  # a second one must not interrupt the removal
        raise Interruption(number)

    handlers = dict.fromkeys(ENDING_SIGNALS, interrupt)
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:  # it is ignored in the background
        del handlers["SIGINT"]
    return handling_signals(handlers)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are user errors of one line, without the usage block."""

    def error(self, message: str) -> typing.NoReturn:
        """Raises the error. `main` prints it."""
        command = self.prog.partition(" ")[2]
        raise UserError(f"{command}: {message} (see `{self.prog} --help`)" if command else message)


def _run(arguments: list[str]) -> int:
    """Parses the arguments, runs the command and returns the exit code."""
    try:
        if not arguments or arguments[0].startswith("-"):
            return _run_without_command(arguments)
        name, *rest = arguments
        if name not in COMMANDS:
            near = difflib.get_close_matches(name, COMMANDS, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(COMMANDS)}"
            raise UserError(f"unknown command '{name}'; {hint}")
        module = importlib.import_module(f"t2m_jax.cli.{name}")
        takes_config_options = getattr(module, "TAKES_CONFIG_OPTIONS", False)
        parser = _Parser(
            prog=f"t2m {name}", description=module.__doc__, allow_abbrev=False, add_help=not takes_config_options
        )
        parser.formatter_class = argparse.RawDescriptionHelpFormatter
        module.add_arguments(parser)
        args, unknown = parser.parse_known_args(rest)
        if takes_config_options:
            args.config_options = unknown
        elif unknown:
            near = difflib.get_close_matches(unknown[0].partition("=")[0], _options(parser, rest), n=1)
            parser.error(f"unknown argument '{unknown[0]}'" + (f"; did you mean '{near[0]}'?" if near else ""))
        # If a signal raised an exception while JAX is imported, its C++ code would crash. Until then, a signal ends the
        # process without ceremony: nothing has been written.
        _import_jax()
        with _ended_by_signals():
            module.run(args)
    except SystemExit as exit_:  # raised by argparse and tyro after --help
        return exit_.code if isinstance(exit_.code, int) else EXIT_OK
    return EXIT_OK


def _import_jax() -> None:
    """Imports JAX for numbers of 32 bits, which all models have, also in processes that the command starts."""
    os.environ.pop("JAX_ENABLE_X64", None)
    importlib.import_module("jax").config.update("jax_enable_x64", False)


def _options(parser: argparse.ArgumentParser, arguments: Sequence[str]) -> list[str]:
    """Returns the options of a parser and of the sub-command that the arguments name."""
    options: list[str] = []
    for action in parser._actions:
        options += action.option_strings
        if isinstance(action, argparse._SubParsersAction):
            chosen = [subparser for name, subparser in action.choices.items() if name in arguments]
            options += [option for subparser in chosen for option in _options(subparser, arguments)]
    return options


def _run_without_command(arguments: list[str]) -> int:
    """Prints the help or the version."""
    width = max(map(len, COMMANDS))
    parser = _Parser(
        prog="t2m",
        usage="t2m [--help] [--version] [--debug] [--completion SHELL] COMMAND ...",
        description="Converts text to human motion.",
        epilog="commands:\n"
        + "\n".join(f"  {name:{width}}  {help_}" for name, help_ in COMMANDS.items())
        + f"\n\n`t2m COMMAND --help` describes a command. To start:\n{FIRST_COMMANDS}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    version = f"t2m_jax {importlib.metadata.version('t2m-jax')}"
    parser.add_argument("--version", action="version", version=version, help="show the version and exit")
    parser.add_argument("--debug", action="store_true", help="show tracebacks and the warnings of libraries")
    shells = "print the script that completes commands and options in this shell: " + ", ".join(SHELLS)
    parser.add_argument("--completion", choices=SHELLS, default=None, metavar="SHELL", help=shells)
    shell = parser.parse_args(arguments).completion
    if shell is None:
        parser.print_help()
    else:
        sys.stdout.write(completion_script(COMMANDS, shell))
    return EXIT_OK


class _PrintableFormatter(logging.Formatter):
    """Names in a stranger's file must not change the terminal."""

    def format(self, record: logging.LogRecord) -> str:
        """Returns the lines of a record with escapes."""
        return "\n".join(map(printable, super().format(record).split("\n")))


def _configure_logging(debug: bool) -> None:
    """Logs the project's messages to standard error. Unless debugging, hides the warnings of other libraries."""

    def is_relevant(record: logging.LogRecord) -> bool:
        library = record.name.partition(".")[0]
        shown_from = logging.CRITICAL if library in REPEATING_LOGGERS else logging.ERROR
        return record.levelno >= shown_from or library not in QUIET_LIBRARIES

    logging.basicConfig(level=logging.INFO, stream=sys.stderr)
    for handler in logging.getLogger().handlers:
        handler.setFormatter(_PrintableFormatter("%(message)s"))
    if debug:
        return
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")  # XLA's own log; the variable is read when jax is imported
    # Levels of loggers would be simpler, but absl installs its own logger class, which an early `getLogger` prevents.
    for handler in logging.getLogger().handlers:
        handler.addFilter(is_relevant)
    for library in QUIET_LIBRARIES:
        warnings.filterwarnings("ignore", module=rf"{library}(\.|$)")
