"""Measure models and compare the results.

`reconstruction` encodes and decodes every clip of a split with a model's tokenizer. `generation` compares motion that a
model generates from the captions of a split with real motion, in the space of an evaluator and by a named protocol.
`prompts` generates from sentences that were held out from training and tests each motion against a kinematic rule.
`inbetween` fills gaps in real motion and measures the joins. `compare` tests whether two reports differ by more than
chance, and `table` puts reports into one table. `t2m evaluate COMMAND --help` describes the options of each.
"""

import argparse
import dataclasses
import os
import shlex
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from t2m_jax.cli.options import (
    add_model_argument,
    add_record,
    add_seed_argument,
    positive,
    print_columns,
    read_record,
    show_next,
    subcommand_adder,
)
from t2m_jax.errors import UserError, printable
from t2m_jax.files.writing import check_output, claim

if TYPE_CHECKING:
    from t2m_jax.data import Dataset
    from t2m_jax.evaluation.report.record import ReconstructionFigures
    from t2m_jax.evaluation.sources import CodeSource
    from t2m_jax.evaluation.task import EvaluationTask
    from t2m_jax.motion.motion import Motion


LABELS = {
    "mpjpe_mm": "MPJPE, mm (root-aligned)",
    "mpjpe_median_clip_mm": "MPJPE of the median clip, mm",
    "global_mpjpe_mm": "global MPJPE, mm",
    "acceleration_error_mm": "acceleration error, mm/frame^2",
    "path_drift_mm": "path drift, mm",
    "heading_drift_degrees": "heading drift, degrees",
    "codebook_usage": "codebook usage",
    "perplexity": "perplexity",
    "num_clips": "clips",
    "num_frames": "frames",
}
QUALITY_LABELS = {
    "bone_variation": "bone variation, share of length",
    "jerk": "jerk, m/s^3",
    "skating_ratio": "skating, share of contacts",
    "skating_speed": "speed of feet in contact, m/s",
    "floating": "floating, share of frames",
    "penetration": "in the floor, share of frames",
}
PLAIN_GROUPS = ("actions", "paces", "manners", "composed")
FREE_GROUPS = (
    *("free", "kit", "subjects", "typos", "free-paces", "free-manners", "then", "while", "counts", "durations"),
    *("all-actions", "warnings"),
)
"""Their sentences are of somebody who saw neither the code nor any caption."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the sub-commands and their options."""
    from t2m_jax.sampling.request import SamplingOptions

    add = subcommand_adder(parser)
    reconstruction = add(run_reconstruction, "measure how well a tokenizer reconstructs real motion")
    generation = add(run_generation, "measure how well generated motion fits captions and real motion")
    prompts = add(run_prompts, "count how often generated motion does what held-out sentences ask for")
    inbetween = add(run_inbetween, "measure how well a model fills gaps in real motion")
    add_model_argument(inbetween)
    _add_data_arguments(inbetween)
    inbetween.add_argument("--seconds", type=float, default=1.6, help="length of the gaps (default: 1.6)")
    inbetween.add_argument("--num-clips", type=positive, default=100, help="clips to use (default: 100)")
    compare = add(run_compare, "test two reports for differences")
    table = add(run_table, "print a table of reports")
    for command in (reconstruction, generation, prompts):
        add_model_argument(command)
        command.add_argument("--json", type=Path, metavar="F", help="also write the figures to this file")
    _add_protocol_arguments(reconstruction, needs_evaluator=False)
    _add_protocol_arguments(generation, needs_evaluator=True)
    for command, more in ((generation, ("raw", "whole")), (prompts, ())):
        add_record(command, SamplingOptions, left_out=("strategy", "max_codes", *more))
        command.add_argument("--greedy", action="store_const", dest="temperature", const=0.0, help="--temperature 0")
    what = "what is asked for; docs/evaluation.md describes each group (default: actions)"
    prompts.add_argument("--group", choices=(*PLAIN_GROUPS, *FREE_GROUPS), default="actions", help=what)
    real = "data set with whose real clips motion is compared; with kit, its file of captions"
    prompts.add_argument("--data", metavar="PATH", help=real)
    samples = "samples per line of the table (default: 20; for the groups of free sentences, 4 of each sentence)"
    prompts.add_argument("--num-seeds", type=positive, help=samples)
    compare.add_argument("reports", nargs=2, type=Path, metavar="REPORT", help="two files of --json")
    _add_table_arguments(table)


def _add_table_arguments(table: argparse.ArgumentParser) -> None:
    table.add_argument("reports", nargs="+", type=Path, metavar="REPORT", help="files of --json")
    styles = ("terminal", "markdown", "latex")
    table.add_argument("--format", choices=styles, default="terminal", help="how to print (default: terminal)")
    table.add_argument("--names", nargs="+", metavar="NAME", help="names of the rows (default: names of the files)")
    plot = "also draw the table into this file (.png, .svg or .pdf; needs the extra `plot`)"
    table.add_argument("--plot", type=Path, metavar="FILE", help=plot)
    by_label = "R-precision that does not count motions of the same label as errors"
    quality = "bones, jerk and feet instead of the evaluator's metrics"
    measures = table.add_mutually_exclusive_group()
    board = "the columns of the benchmark, with text following (docs/benchmark.md)"
    flags = (("--by-label", "labels", by_label), ("--quality", "quality", quality), ("--benchmark", "benchmark", board))
    for flag, value, text in flags:
        measures.add_argument(flag, dest="measures", action="store_const", const=value, default="captions", help=text)


def _add_protocol_arguments(parser: argparse.ArgumentParser, *, needs_evaluator: bool) -> None:
    _add_data_arguments(parser)
    evaluator = "folder of an evaluator, run of `t2m train evaluator`, benchmark-free or benchmark-nc"
    if not needs_evaluator:
        evaluator += " (optional)"
    parser.add_argument("--evaluator", required=needs_evaluator, metavar="E", help=evaluator)
    parser.add_argument(
        "--protocol",
        default="t2m-gpt",
        help="t2m-gpt (default), t2m-gpt-paper, text-to-motion, benchmark, momask or strict",
    )
    parser.add_argument("--num-repeats", type=positive, default=20, help="repeats (default: 20)")
    parser.add_argument("--batch", type=int, default=32, help="pairs ranked together, for small splits (default: 32)")
    parser.add_argument("--html", type=Path, metavar="F", help="also write a page with plots and motions")


def _add_data_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--data", required=True, metavar="DIR", help="data-set folder")
    parser.add_argument("--split", default="test", help="split to measure on (default: test)")
    add_seed_argument(parser)


def run(args: argparse.Namespace) -> None:
    """Checks the files to write and runs the command."""
    # Each command has some of these options only, hence `getattr` with a default.
    if getattr(args, "html", None) and args.evaluator is None:
        raise UserError("--html: the page shows motions as an evaluator ranks them; use it with --evaluator")
    # Before the measurement, which may take hours.
    outputs = [check_output(path) for name in ("json", "html", "plot") if (path := getattr(args, name, None))]
    with claim(outputs):
        args.run_command(args)


def run_reconstruction(args: argparse.Namespace) -> None:
    """Prints how well a tokenizer reconstructs motion; with an evaluator, also by a protocol."""
    from t2m_jax.checkpoints import load_tokenizer
    from t2m_jax.data import open_dataset
    from t2m_jax.evaluation.reconstruction import evaluate_reconstruction
    from t2m_jax.evaluation.report.record import save_reconstruction
    from t2m_jax.evaluation.sources import Reconstruction
    from t2m_jax.sampling.compilation import use_compilation_cache

    use_compilation_cache()
    tokenizer = load_tokenizer(args.model)
    dataset = open_dataset(args.data)
    task = _make_task(args, dataset, unit=tokenizer.config.downsample) if args.evaluator else None
    figures = evaluate_reconstruction(tokenizer, dataset, split=args.split)
    found = dataclasses.asdict(figures)
    numbers = [(label, found[name]) for name, label in LABELS.items()]
    print_columns([(label, f"{value:,.{3 if isinstance(value, float) else 0}f}") for label, value in numbers])
    sys.stdout.write("\n")
    kinds = ("real_quality", "quality", "cleaned_quality")
    lines = [(label, *(f"{found[kind][name]:.3f}" for kind in kinds)) for name, label in QUALITY_LABELS.items()]
    print_columns([("", "real", "decoded", "cleaned"), *lines])
    if task is not None:
        sys.stdout.write("\n")
        _measure(args, task, Reconstruction(tokenizer), figures)
        return
    if args.json:
        save_reconstruction(args.json, figures)
    options = shlex.join(["--model", args.model, "--data", args.data])
    show_next(f"t2m evaluate reconstruction {options} --evaluator RUN --json reconstruction.json")


def run_generation(args: argparse.Namespace) -> None:
    """Evaluates motion that a model generates."""
    from t2m_jax.data import open_dataset
    from t2m_jax.data.checks import check_feature_dim
    from t2m_jax.evaluation.sources import make_generation
    from t2m_jax.sampling import TextToMotion
    from t2m_jax.sampling.request import SamplingOptions

    options = read_record(SamplingOptions, args)
    model = TextToMotion.load(args.model)
    dataset = open_dataset(args.data)
    check_feature_dim(dataset, model.config.tokenizer.feature_dim, reader="the model")
    task = _make_task(args, dataset, unit=model.config.tokenizer.downsample)
    _measure(args, task, make_generation(model, task.samples.clips, options=options))


def _make_task(args: argparse.Namespace, dataset: "Dataset", *, unit: int) -> "EvaluationTask":
    from t2m_jax.checkpoints import load_trained_evaluator
    from t2m_jax.evaluation.protocols import find_protocol
    from t2m_jax.evaluation.task import make_task

    protocol = dataclasses.replace(find_protocol(args.protocol), batch=args.batch)
    evaluator = load_trained_evaluator(args.evaluator)
    return make_task(dataset, evaluator, protocol, split=args.split, seed=args.seed, unit=unit)


def _measure(
    args: argparse.Namespace,
    task: "EvaluationTask",
    source: "CodeSource",
    figures: "ReconstructionFigures | None" = None,
) -> None:
    """Evaluates a source, prints its table and writes the files that were asked for."""
    from t2m_jax.evaluation.report.formats import format_table
    from t2m_jax.evaluation.report.gallery import gather_details
    from t2m_jax.evaluation.report.page import save_page
    from t2m_jax.evaluation.report.record import save_report
    from t2m_jax.evaluation.report.tables import make_table
    from t2m_jax.evaluation.run import evaluate
    from t2m_jax.export import viewer_html

    # Finished repeats are kept there, so that an evaluation of hours can continue after an interruption.
    partial = Path(f"{args.json}.partial") if args.json else None
    report = evaluate(task, source, num_repeats=args.num_repeats, model=args.model, partial=partial)
    report = dataclasses.replace(report, reconstruction=figures)
    header = dataclasses.asdict(report.header)
    facts = ", ".join(f"{name} {value}" for name, value in header.items() if value is not None)
    sys.stdout.write(f"{printable(facts)}\n\n")
    # The facts are above already, once for both tables.
    for measures in ("captions", "quality"):
        table = make_table([report], [source.kind], measures=measures)._replace(facts={})
        sys.stdout.write(format_table(table, style="terminal") + "\n\n")
    if args.json:
        save_report(args.json, report)
        Path(f"{args.json}.partial").unlink(missing_ok=True)
    if args.html:
        save_page(args.html, report, gather_details(task, source), viewer=viewer_html)
    if args.json:
        show_next(shlex.join(["t2m", "evaluate", "table", str(args.json)]))
    else:
        show_next("the same with --json F.json, then `t2m evaluate table F.json`")


def run_prompts(args: argparse.Namespace) -> None:
    """Prints how often generated motion does what was asked."""
    from t2m_jax.evaluation.prompts.catalog import prompt_tests
    from t2m_jax.evaluation.prompts.following import evaluate_prompt_following
    from t2m_jax.evaluation.prompts.results import PromptReport, following_table, save_prompt_report
    from t2m_jax.sampling import TextToMotion
    from t2m_jax.sampling.request import MotionRequest, SamplingOptions
    from t2m_jax.text.coverage import PromptWarning

    tests = prompt_tests(args.group, args.data)
    num_seeds = args.num_seeds or (20 if args.group in PLAIN_GROUPS else None)
    options = read_record(SamplingOptions, args)
    model = TextToMotion.load(args.model)

    def generate(sentence: str, seed: int) -> "Motion":
        return next(model.make(MotionRequest(captions=(sentence,), seed=seed, options=options)))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PromptWarning)  # whether the model can do what is asked is measured here
        results = evaluate_prompt_following(tests, generate, num_seeds=num_seeds)
    sys.stdout.write(following_table(results) + "\n")
    if args.json:
        motion = "decoded" if options.raw else "cleaned"
        save_prompt_report(args.json, PromptReport(group=args.group, motion=motion, contents=tuple(results)))
    show_next(shlex.join(["t2m", "generate", "a person walks forward", "--model", args.model]))


def run_inbetween(args: argparse.Namespace) -> None:
    """Prints how well a model fills gaps in real motion, compared with an interpolation."""
    from t2m_jax.data import open_dataset
    from t2m_jax.evaluation.inbetween import evaluate_inbetween, format_inbetween
    from t2m_jax.sampling import TextToMotion
    from t2m_jax.sampling.request import check_seconds
    from t2m_jax.text.coverage import PromptWarning

    check_seconds(args.seconds)
    model = TextToMotion.load(args.model)
    dataset = open_dataset(args.data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PromptWarning)
        figures = evaluate_inbetween(
            model, dataset, split=args.split, seconds=args.seconds, num_clips=args.num_clips, seed=args.seed
        )
    sys.stdout.write(format_inbetween(figures) + "\n")
    show_next(shlex.join(["t2m", "generate", "a person walks", "--from", "FILE", "--redo", "2.0:4.0"]))


def run_compare(args: argparse.Namespace) -> None:
    """Prints the comparison of two reports."""
    from t2m_jax.evaluation.report.comparison import compare_reports, comparison_table
    from t2m_jax.evaluation.report.record import load_report

    differences = compare_reports(*map(load_report, args.reports))
    sys.stdout.write(comparison_table([path.stem for path in args.reports], differences) + "\n")
    show_next(shlex.join(["t2m", "evaluate", "table", *map(str, args.reports)]))


def run_table(args: argparse.Namespace) -> None:
    """Prints the table of some reports."""
    from t2m_jax.evaluation.report.formats import format_table
    from t2m_jax.evaluation.report.record import load_report
    from t2m_jax.evaluation.report.tables import make_table

    if args.plot is not None:
        from t2m_jax.evaluation.report.charts import check_chart, save_chart, table_chart

        check_chart(args.plot)
    # Short names, but reports of different folders may have the same one.
    stems = [path.stem for path in args.reports]
    names = args.names or (stems if len(set(stems)) == len(stems) else list(map(str, args.reports)))
    table = make_table([load_report(path) for path in args.reports], names, measures=args.measures)
    # https://no-color.org; files and pipes get no codes of colors either.
    color = sys.stdout.isatty() and "NO_COLOR" not in os.environ
    sys.stdout.write(format_table(table, style=args.format, color=color) + "\n")
    if args.plot is not None:
        save_chart(args.plot, table_chart(table))
    others = [str(path) for path in args.reports[1:2]] or ["OTHER.json"]
    show_next(shlex.join(["t2m", "evaluate", "compare", str(args.reports[0]), *others]))
