"""Options of commands, made from the fields of the library's records, and what several commands share."""

import argparse
import contextlib
import re
import shlex
import sys
import typing
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar

from t2m_jax.errors import UserError, printable
from t2m_jax.records import RecordField, fields_of, record_from

T = TypeVar("T")
Run = Callable[[argparse.Namespace], Any]


def _times(text: str) -> tuple[float | None, float | None]:
    """Returns the seconds in BEGIN:END, of which one may be left out."""
    try:
        begin, end = (float(part) if part else None for part in text.split(":"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not BEGIN:END in seconds, such as 2.0:4.0") from None
    return begin, end


def _span(text: str) -> tuple[float | None, float | None]:
    if None in (times := _times(text)):
        raise argparse.ArgumentTypeError(f"{text!r} is not BEGIN:END in seconds, such as 2.0:4.0")
    return times


def _path(text: str) -> tuple[tuple[float, float], ...]:
    from t2m_jax.motion.changes import path_from_text

    try:
        return path_from_text(text)
    except UserError as error:  # argparse would hide what is wrong, and it names the option itself
        raise argparse.ArgumentTypeError(str(error).removeprefix("path: ")) from None


SHORT: Mapping[str, str] = {
    "start": "--from",
    "span": "--redo",
    "strength": "--vary",
    "targets": "--at",
    "begin": "--trim",
    "end": "--trim",
}
"""Options that are called otherwise than their fields."""
TYPES: Mapping[str, Mapping[str, Any]] = {
    "start": {"type": Path, "metavar": "FILE"},
    "span": {"type": _span, "metavar": "BEGIN:END"},
    "path": {"type": _path, "metavar": '"X,Z X,Z ..."'},
}
"""How fields are read that are neither a number, a choice nor yes or no."""
NO_OPTIONS = ("captions", "strategy")
"""Fields of `MotionRequest` that are made from other options."""
TRIM = ("begin", "end")
"""Fields that are one option, `--trim BEGIN:END`."""


def add_record(parser: argparse.ArgumentParser, record: type, *, left_out: Collection[str] = ()) -> None:
    """Declares an option for each field of a record. An option that is not given is None."""
    for field in fields_of(record):
        if field.name in TRIM:
            continue
        if field.name not in left_out:
            _add_field(parser, field)
    if set(TRIM) <= {field.name for field in fields_of(record)}:
        parser.add_argument("--trim", type=_times, metavar="BEGIN:END", help="keep these seconds; each may be left out")


def _add_field(parser: argparse.ArgumentParser, field: RecordField) -> None:
    flag = option_of(field.name)
    # Of `float | None`, the number. None is what an option has that is not given.
    (kind, *_) = [part for part in typing.get_args(field.annotation) if part is not type(None)] or [field.annotation]
    text = field.text[:1].lower() + field.text[1:].rstrip(".").replace("%", "%%")
    for name, short in SHORT.items():
        text = text.replace(f"`{name}`", short)
    if isinstance(field.default, int | float) and field.annotation is not bool:
        text += f" (default: {field.default:g})"
    if field.annotation is bool:
        parser.add_argument(flag, dest=field.name, action="store_true", default=None, help=text)
    elif typing.get_origin(kind) is Literal:
        parser.add_argument(flag, dest=field.name, choices=typing.get_args(kind), help=text)
    else:
        special = TYPES.get(field.name, {"type": kind, "metavar": field.name.rpartition("_")[2].upper()})
        parser.add_argument(flag, dest=field.name, help=text, **special)


def option_of(name: str) -> str:
    """Returns the option of a field."""
    return SHORT.get(name, f"--{name.replace('_', '-')}")


def read_record(record: type[T], args: argparse.Namespace, **more: Any) -> T:
    """Returns a record with the options that were given, and further fields.

    Raises:
        UserError: A value cannot be used. The message names the field; see `naming_options`.
    """
    # What is not given is left to the record, which has the defaults.
    given = {name: value for name, value in vars(args).items() if value is not None}
    begin, end = given.get("trim", (None, None))
    return record_from(record, given | {"begin": begin, "end": end} | more)


@contextlib.contextmanager
def naming_options() -> Iterator[None]:
    """Lets errors of a block, or of a function, name options in place of fields of `Changes` and `MotionRequest`."""
    try:
        yield
    except UserError as error:
        from t2m_jax.motion.changes import Changes
        from t2m_jax.sampling.request import MotionRequest

        name, _, reason = str(error).partition(": ")
        fields = {field.name for record in (Changes, MotionRequest) for field in fields_of(record)} - {*NO_OPTIONS}
        if name.replace("-", "_") not in fields:
            raise
        reason = reason.replace("give it as start", f"give it with {SHORT['start']}")
        reason = re.sub(r"excludes (\w+)", lambda other: f"excludes {option_of(other[1])}", reason)
        raise UserError(f"{option_of(name.replace('-', '_'))}: {reason}") from None


MODEL_HELP = "bundled name, bundle or run folder, or name on the Hugging Face hub: user/name or user/name@revision"


def add_model_argument(parser: argparse.ArgumentParser) -> None:
    """Declares which model is used."""
    parser.add_argument("--model", default="demo", help=f"{MODEL_HELP} (default: demo)")


def add_seed_argument(parser: argparse.ArgumentParser) -> None:
    """Adds `--seed` for what is random in all of a command."""
    parser.add_argument("--seed", type=int, default=0, help="start of every random choice (default: 0)")


def add_rig_arguments(parser: argparse.ArgumentParser, files: str) -> None:
    """Declares the rig of files that are read, and their axis that points up."""
    text = f"rig of {files}: a name, or a table as `t2m data rig` writes it (default: recognized from the joints)"
    parser.add_argument("--rig", metavar="TABLE", help=text)
    parser.add_argument("--up", choices=("y", "z"), help=f"axis that points up in {files} (default: found)")


def positive(text: str) -> int:
    """Returns the number of an option that counts things, at least 1."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number above 0")
    return int(text)


def subcommand_adder(parser: argparse.ArgumentParser) -> Callable[[Run, str], argparse.ArgumentParser]:
    """Returns a function that adds a sub-command `x` for a function `run_x` and its help, and returns its parser.

    The parsed arguments have the function as `run_command`.
    """
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=type(parser))

    def add(function: Run, help_: str) -> argparse.ArgumentParser:
        name = function.__name__.removeprefix("run_")
        description = f"{help_[0].upper()}{help_[1:]}."
        command = commands.add_parser(name, help=help_, description=description, allow_abbrev=False)
        command.set_defaults(run_command=function)
        return command

    return add


def print_columns(lines: Sequence[Sequence[str]]) -> None:
    """Prints lines of cells, in columns as wide as their longest cell."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        cells = (cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        sys.stdout.write("  ".join(cells).rstrip() + "\n")


def show_next(command: str) -> None:
    """Prints the command to run next on standard error, so that standard output stays easy to parse."""
    sys.stderr.write(f"next: {printable(command)}\n")


def show_written(files: Sequence[Path], *, is_glb_read: bool) -> None:
    """Prints how to look at files of motions: `is_glb_read` says whether a `.glb` file among them has one animation."""
    pages = [path for path in files if path.suffix.lower() == ".html"]
    formats = (".npz", ".bvh", ".vrma", *([".glb"] if is_glb_read else []))
    readable = [path for path in files if path.suffix.lower() in formats]
    if pages:
        show_next(f"open {shlex.quote(str(pages[0]))} in a browser")
    elif readable:
        show_next(f"t2m view {shlex.quote(str(readable[0]))} -o motion.html")
    else:
        show_next(f"open {shlex.quote(str(files[0]))}")
