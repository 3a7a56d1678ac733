"""Turn sentences into motion files: `t2m generate "a person waves" -o wave.html -o wave.bvh`."""

import argparse
import contextlib
import shlex
import sys
import warnings
from collections import deque
from pathlib import Path

from t2m_jax.cli.changes import add_change_arguments, changed, check_changes, file_options
from t2m_jax.cli.edits import add_edit_arguments, check_edits, edited_motions
from t2m_jax.cli.next_step import show_next
from t2m_jax.errors import UserError, one_line

MAX_ON_PAGE = 24
"""Motions in one .html file: more would be too small to see, and take long to open."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    parser.add_argument("text", nargs="+", help="sentences in quotes; each gives one motion (or --num-samples)")
    add_model_argument(parser)
    add_edit_arguments(parser)
    parser.add_argument("--seed", type=int, default=0, help="same seed, same motion (default: 0)")
    parser.add_argument("--num-samples", type=int, default=1, help="motions per sentence (default: 1)")
    add_sampling_arguments(parser)
    add_raw_argument(parser)
    add_change_arguments(parser)
    formats = ".npz .bvh .glb .gif .mp4 .png or .html"
    files = f"{formats}; can be repeated; several motions share a .html file; other files get -0, -1, ..."
    parser.add_argument("-o", "--output", action="append", metavar="FILE", help=f"{files} (default: motion.html)")


def add_model_argument(parser: argparse.ArgumentParser) -> None:
    """Declares which model is used; other commands have the same option."""
    text = "bundled name, bundle or run folder, or name on the Hugging Face hub: user/name or user/name@revision"
    parser.add_argument("--model", default="demo", help=f"{text} (default: demo)")


def add_sampling_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares how codes are sampled; `t2m evaluate generation` and `prompts` have the same options."""
    parser.add_argument("--temperature", type=float, default=1.0, help="below 1 is safer; 0 is greedy (default: 1)")
    parser.add_argument("--top-k", type=int, help="choose among this many of the likeliest codes")
    parser.add_argument("--top-p", type=float, help="choose among the likeliest codes up to this sum")
    parser.add_argument("--guidance-scale", type=float, help="strength of the text, for models trained with guidance")
    stop_help = "when a motion ends, for models with a stop head (default: the model's own rule)"
    parser.add_argument("--stop-rule", choices=("argmax", "threshold", "sampled"), help=stop_help)


def add_raw_argument(parser: argparse.ArgumentParser) -> None:
    """Declares whether motion is cleaned; `t2m evaluate prompts` has the same option."""
    parser.add_argument("--raw", action="store_true", help="motion as decoded, without the clean-up")


def run(args: argparse.Namespace) -> None:
    """Generates, writes the files, and prints their names and the next command."""
    from t2m_jax.files import claim
    from t2m_jax.motion.formats import check_motion_output
    from t2m_jax.text.coverage import PromptWarning
    from t2m_jax.text.prompts import check_prompt

    for text in [*args.text, *(args.then or [])]:
        check_prompt(text)
    _check_quotes(args.text)
    check_edits(args)
    outputs = [check_motion_output(output) for output in args.output or ["motion.html"]]
    check_changes(args, outputs)
    first = [check_motion_output(_numbered(args, output, 0)) for output in outputs]
    # The first files are claimed from the start, so that two commands do not mix their motions. The others are claimed
    # one by one, because there may be more of them than a process can have open files.
    with claim(first), warnings.catch_warnings():
        warnings.simplefilter("always", PromptWarning)
        warnings.showwarning = _show_warning  # type: ignore[assignment]  # it needs the message only
        written = _generate(args, outputs)
    pages = [path for path in written if path.suffix == ".html"]
    convertible = [path for path in written if path.suffix in (".npz", ".bvh", ".glb")]
    if pages:
        show_next(f"open {shlex.quote(str(pages[0]))} in a browser")
    elif convertible:
        show_next(f"t2m view {shlex.quote(str(convertible[0]))} -o motion.html")
    else:
        show_next(f"open {shlex.quote(str(written[0]))}")


def _check_quotes(texts: list[str]) -> None:
    """Raises `UserError` if the texts are probably the words of one sentence, without its quotes."""
    if len(texts) > 1 and all(len(text.split()) == 1 for text in texts) and not all(text[-1] in ".!" for text in texts):
        sentence = shlex.quote(" ".join(texts))
        raise UserError(
            f"{len(texts)} sentences of one word each; for one sentence, use quotes: t2m generate {sentence}; for "
            "several, end them with a period"
        )


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    sys.stderr.write(f"t2m: warning: {one_line(str(message))}\n")


def _motions_per_file(output: Path) -> int:
    return MAX_ON_PAGE if output.suffix.lower() == ".html" else 1


def _numbered(args: argparse.Namespace, output: Path, number: int) -> Path:
    """Returns the file of a motion: `output` if there is only one file, else `output` with a number in its name."""
    size = _motions_per_file(output)
    return output if len(args.text) * args.num_samples <= size else output.with_stem(f"{output.stem}-{number // size}")


def _generate(args: argparse.Namespace, outputs: list[Path]) -> list[Path]:
    """Writes the files and returns their names."""
    from t2m_jax.files import claim
    from t2m_jax.motion import Motion
    from t2m_jax.motion.formats import save_motions
    from t2m_jax.sampling import TextToMotion
    from t2m_jax.sampling.strategies import make_strategy

    options = {"guidance_scale": args.guidance_scale, "raw": args.raw, "seed": args.seed}
    options |= {"num_samples": args.num_samples}
    options |= {"strategy": make_strategy(args.temperature, args.top_k, top_p=args.top_p)}
    given = None if args.start is None else Motion.load(args.start)
    model = TextToMotion.load(args.model)
    if args.then or given is not None or args.seconds is not None:
        motions = edited_motions(model, given, args, **options)
    else:
        motions = model.generate_each(args.text, stop_rule=args.stop_rule, **options)
    written, count, recent = [], len(args.text) * args.num_samples, deque[Motion](maxlen=MAX_ON_PAGE)
    for number, generated in enumerate(motions):
        recent.append(changed(generated, args))
        for output in outputs:
            size = _motions_per_file(output)
            if (number + 1) % size and number + 1 < count:  # the file gets further motions
                continue
            path = _numbered(args, output, number)
            with claim([path]) if number >= size else contextlib.nullcontext():  # `run` has claimed the first
                save_motions(path, list(recent)[-(number % size + 1) :], **file_options(path, args))
            sys.stdout.write(f"{path}\n")
            written.append(path)
    return written
