"""Options of `t2m generate` for several sentences, and for changes of a given motion."""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from t2m_jax.errors import UserError

if TYPE_CHECKING:
    from t2m_jax.motion import Motion
    from t2m_jax.sampling import TextToMotion


def add_edit_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options."""
    parser.add_argument("--then", action="append", metavar="TEXT", help="a sentence that follows; can be repeated")
    formats = ".npz, .bvh, .glb or .amc"
    parser.add_argument("--from", dest="start", type=Path, metavar="FILE", help=f"a motion to go on from: {formats}")
    parser.add_argument(
        "--redo", type=_span, metavar="BEGIN:END", help="replace these seconds of the motion of --from by the sentence"
    )
    parser.add_argument(
        "--vary", type=float, metavar="SHARE", help="vary the motion of --from: 0 changes nothing, 1 keeps nothing"
    )
    parser.add_argument(
        "--seconds", type=float, help="length for each sentence, in whole codes (default: the model decides)"
    )


def _span(text: str) -> tuple[float, float]:
    try:
        begin, end = map(float, text.split(":"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not BEGIN:END in seconds, such as 2.0:4.0") from None
    return begin, end


def check_edits(args: argparse.Namespace) -> None:
    """Raises `UserError` if options do not go together, or a value cannot be used with any model."""
    from t2m_jax.sampling.request import check_seconds

    if args.then and len(args.text) > 1:
        raise UserError(f"--then: follows one sentence, not {len(args.text)}; use it for each further sentence")
    given = [name for name in ("redo", "vary", "then", "seconds", "stop_rule") if getattr(args, name) is not None]
    for name in [name for name in given if name in ("redo", "vary")]:
        if args.start is None:
            raise UserError(f"--{name}: changes a motion; give its file with --from")
        others = [other for other in given if other != name]
        if others:
            raise UserError(f"--{name}: does not go together with --{others[0].replace('_', '-')}")
    if args.seconds is not None:
        check_seconds(args.seconds)
    if args.vary is not None and not 0 <= args.vary <= 1:
        raise UserError(f"vary: {args.vary:g} is not a number from 0 to 1")


def edited_motions(
    model: "TextToMotion", given: "Motion | None", args: argparse.Namespace, **options: Any
) -> "Iterator[Motion]":
    """Yields the motions that the options ask for, sentence by sentence."""
    for text in args.text:
        if given is not None and args.redo is not None:
            yield from model.redo(given, args.redo, text, **options)
        elif given is not None and args.vary is not None:
            yield from model.vary(given, args.vary, text, **options)
        else:
            chain = [text, *(args.then or [])]
            yield from model.generate_chain(
                chain, start=given, seconds=args.seconds, stop_rule=args.stop_rule, **options
            )
