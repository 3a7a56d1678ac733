"""Turn sentences into motion files: `t2m generate "a person waves" -o wave.html -o wave.bvh`."""

import argparse
import contextlib
import dataclasses
import itertools
import shlex
import sys
import warnings
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from t2m_jax.cli.options import (
    NO_OPTIONS,
    add_model_argument,
    add_record,
    add_rig_arguments,
    naming_options,
    option_of,
    read_record,
    show_written,
)
from t2m_jax.cli.view import add_file_arguments, file_options, open_character, save
from t2m_jax.errors import UserError, one_line

if TYPE_CHECKING:
    from t2m_jax.motion.changes import Changes
    from t2m_jax.motion.character import Character
    from t2m_jax.motion.motion import Motion
    from t2m_jax.motion.targets import Target
    from t2m_jax.sampling.request import MotionRequest

MAX_ON_PAGE = 24
"""Motions in one .html file: more would be too small to see, and take long to open."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    from t2m_jax.motion.changes import Changes
    from t2m_jax.sampling.request import MotionRequest

    parser.add_argument("text", nargs="+", help="sentences in quotes; each gives one motion (or --num-samples)")
    parser.add_argument("--then", action="append", metavar="TEXT", help="a sentence that follows; can be repeated")
    add_model_argument(parser)
    add_record(parser, MotionRequest, left_out=(*NO_OPTIONS, "targets"))
    places = (
        "right_wrist=X,Y,Z (any joint), root=X,Z or facing=DEGREES; += is seen from the root; 'PLACE exact' to 5 mm"
    )
    at = f"where something should be at a time in seconds, or in BEGIN:END: {places}; can be repeated"
    parser.add_argument("--at", nargs=2, action="append", metavar=("TIME", "PLACE"), help=at)
    pose = "a pose at a time: the first frame of a motion file; 'FILE exact' to 5 mm; can be repeated"
    parser.add_argument("--pose", nargs=2, action="append", metavar=("TIME", "FILE"), help=pose)
    add_rig_arguments(parser, "the file of --from")
    add_record(parser, Changes)
    add_file_arguments(parser)
    formats = ".npz .bvh .glb .vrma .gif .mp4 .png or .html"
    files = f"{formats}; can be repeated; several motions share a .html file; other files get -0, -1, ..."
    parser.add_argument("-o", "--output", action="append", metavar="FILE", help=f"{files} (default: motion.html)")


@naming_options()
def run(args: argparse.Namespace) -> None:
    """Generates, writes the files, and prints their names and the next command."""
    from t2m_jax.files.writing import claim
    from t2m_jax.motion.changes import Changes
    from t2m_jax.motion.formats import check_motion_output
    from t2m_jax.text.coverage import PromptWarning

    said: list[str] = []

    def show_warning(message: Warning | str, *_: object, **__: object) -> None:
        said.append(str(message))
        _warn(f"{message}")

    _check_quotes(args.text)
    requests = list(_requests(args))
    count = sum(request.num_samples for request in requests)
    outputs = [check_motion_output(output) for output in args.output or ["motion.html"]]
    changes = read_record(Changes, args)
    if changes.clean and requests[0].options.raw:
        raise UserError("--raw: excludes --clean")
    options = {output: file_options(output, args, outputs) for output in outputs}
    character = open_character(args, outputs)
    from t2m_jax.sampling.pipeline import TextToMotion  # slow, so only now

    # The first files are claimed from the start, so that two commands do not mix their motions. The others are claimed
    # one by one, because there may be more of them than a process can have open files.
    first = [check_motion_output(_file_of(output, 0, count)) for output in outputs]
    with claim(first, tells=False), warnings.catch_warnings():
        warnings.simplefilter("always", PromptWarning)
        warnings.showwarning = show_warning  # type: ignore[assignment]  # it needs the message only
        if requests[0].targets and (moved := _changed(changes)):
            _warn(f"targets are met before these changes, not in the file: {moved}")
        made = TextToMotion.load(args.model).make(*requests)
        told = _show_distances(requests, made) if requests[0].targets else _show_misses(made, said, count=count)
        motions = map(changes.apply, told)
        written = list(_write(motions, options, count, character))
    # The file of a character may have other animations, too.
    show_written(written, is_glb_read=character is None)


def _changed(changes: "Changes") -> str:
    """Returns the options of changes that move a motion in space or time."""
    fields = (field for field in dataclasses.fields(changes) if field.name not in ("clean", "fps"))
    names = [field.name for field in fields if getattr(changes, field.name) != field.default]
    # In their order, and each once: --trim sets two fields.
    return ", ".join(dict.fromkeys(map(option_of, names)))


def _check_quotes(texts: list[str]) -> None:
    """Raises `UserError` if the texts are probably the words of one sentence, without its quotes."""
    if len(texts) > 1 and all(len(text.split()) == 1 for text in texts) and not all(text[-1] in ".!" for text in texts):
        sentence = shlex.quote(" ".join(texts))
        raise UserError(
            f"{len(texts)} sentences of one word each; for one sentence, use quotes: t2m generate {sentence}; for "
            "several, end them with a period"
        )


def _requests(args: argparse.Namespace) -> "Iterator[MotionRequest]":
    """Yields a request for each text."""
    from t2m_jax.motion.formats import load_motion
    from t2m_jax.sampling.request import MotionRequest

    if args.then and len(args.text) > 1:
        raise UserError(f"--then: follows one sentence, not {len(args.text)}; use it for each further sentence")
    # With a character, the rig is that of its joints.
    chosen = {"rig": args.rig if args.character is None else None, "up": args.up}
    for name, value in chosen.items():
        if value is not None and args.start is None:
            raise UserError(f"--{name} {value}: is for a file to go on from; add --from FILE")
    start = None if args.start is None else load_motion(args.start, **chosen)
    targets = tuple(_targets(args))
    for text in args.text:
        yield read_record(MotionRequest, args, captions=(text, *(args.then or ())), start=start, targets=targets)


def _targets(args: argparse.Namespace) -> "Iterator[Target]":
    """Yields the targets of --at and --pose."""
    from t2m_jax.motion.formats import load_motion
    from t2m_jax.motion.targets import read_target

    yield from (read_target(f"{time} {place}") for time, place in args.at or ())
    for time, file in args.pose or ():
        try:
            seconds = float(time)
        except ValueError:
            raise UserError(f"--pose {time} {file}: {time!r} is not a number of seconds") from None
        name, *exact = file.rsplit(" ", 1) if file.endswith(" exact") else [file]
        yield read_target((seconds, load_motion(name), *exact))


def _warn(message: str) -> None:
    sys.stderr.write(f"t2m: warning: {one_line(message)}\n")


def _show_misses(motions: "Iterator[Motion]", said: list[str], *, count: int) -> "Iterator[Motion]":
    """Yields motions, and says what each misses that was not said of its sentence before it was made."""
    for number, motion in enumerate(motions):
        missed = motion.warning
        for known in said:
            missed = missed.replace(known, "")
        if missed.strip():
            # The number is that of its file.
            _warn(f"motion {number}: {missed.strip()}" if count > 1 else missed.strip())
        yield motion


def _show_distances(requests: "list[MotionRequest]", motions: "Iterator[Motion]") -> "Iterator[Motion]":
    """Yields motions, and says on standard error how far each is from its targets."""
    from t2m_jax.motion.targets import distances

    for request in requests:
        for motion in itertools.islice(motions, request.num_samples):
            found = zip(request.targets, distances(motion, request.targets), strict=True)
            for target, far in found:
                met = "met" if target.is_met(far) else "missed"
                sys.stderr.write(f"t2m: {target.name}: {met}, {far:.3f} {target.unit} away\n")
            yield motion


def _motions_per_file(output: Path) -> int:
    return MAX_ON_PAGE if output.suffix.lower() == ".html" else 1


def _file_of(output: Path, number: int, count: int) -> Path:
    """Returns the file of a motion: `output` if there is only one file, else `output` with a number in its name."""
    size = _motions_per_file(output)
    return output if count <= size else output.with_stem(f"{output.stem}-{number // size}")


def _write(
    motions: "Iterator[Motion]", options: dict[Path, dict[str, str | bool]], count: int, character: "Character | None"
) -> Iterator[Path]:
    """Writes each file as soon as its motions are there, and yields its name; `options` has the outputs."""
    from t2m_jax.files.writing import claim

    # What the next page needs; with a million samples, not all motions fit into the memory.
    recent = deque["Motion"](maxlen=MAX_ON_PAGE)
    for number, motion in enumerate(motions):
        recent.append(motion)
        for output in options:
            size = _motions_per_file(output)
            if (number + 1) % size and number + 1 < count:  # the file gets further motions
                continue
            path = _file_of(output, number, count)
            # `run` has claimed the first.
            with claim([path], tells=False) if number >= size else contextlib.nullcontext():
                save(path, list(recent)[-(number % size + 1) :], options[output], character)
            sys.stdout.write(f"{path}\n")
            yield path
