"""Measure a model on the benchmark: `t2m benchmark MODEL --json F`.

One report has the evaluator's metrics over seeded repeats, the quality of motion, and text following on held-out
sentences. The data are made by `sh configs/benchmark/data.sh ARCHIVES`; the evaluators of both tracks are part of
the package.
`t2m evaluate table --benchmark F...` makes the table of several reports, and `t2m evaluate compare` compares two.
docs/benchmark.md says which differences mean something.
"""

import argparse
import dataclasses
import math
import shlex
import sys
from pathlib import Path

from t2m_jax.cli.options import MODEL_HELP, add_record, add_seed_argument, positive, read_record, show_next
from t2m_jax.files.writing import check_output, claim


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    from t2m_jax.sampling.request import SamplingOptions

    parser.add_argument("model", metavar="MODEL", help=MODEL_HELP)
    tracks = "free has motion for all uses, nc also motion for non-commercial use (default: free)"
    parser.add_argument("--track", choices=("free", "nc"), default="free", help=tracks)
    parser.add_argument("--data", metavar="DIR", help="data of the track (default: data/benchmark-free or -nc)")
    evaluator = "folder or run of an evaluator (default: the packaged one of the track)"
    parser.add_argument("--evaluator", metavar="E", help=evaluator)
    parser.add_argument("--split", default="test", help="split to measure on (default: test)")
    parser.add_argument("--num-repeats", type=positive, default=5, help="repeats (default: 5)")
    add_seed_argument(parser)
    parser.add_argument("--json", type=Path, metavar="F", help="write the report to this file")
    add_record(parser, SamplingOptions, left_out=("strategy", "max_codes", "raw", "whole"))


def run(args: argparse.Namespace) -> None:
    """Measures, prints the table and writes the report."""
    outputs = [] if args.json is None else [check_output(args.json)]
    with claim(outputs):
        _measure(args)
    name = "F.json" if args.json is None else f"{args.json}"
    show_next(shlex.join(["t2m", "evaluate", "table", "--benchmark", name]))


def _measure(args: argparse.Namespace) -> None:
    from t2m_jax.checkpoints.evaluator import load_trained_evaluator
    from t2m_jax.data import open_dataset
    from t2m_jax.evaluation.benchmark import PROTOCOL, TRACKS, UNIT, check_track, measure_following
    from t2m_jax.evaluation.protocols import find_protocol
    from t2m_jax.evaluation.report.formats import format_table
    from t2m_jax.evaluation.report.record import save_report
    from t2m_jax.evaluation.report.tables import make_table
    from t2m_jax.evaluation.run import evaluate
    from t2m_jax.evaluation.sources import make_generation
    from t2m_jax.evaluation.task import make_task
    from t2m_jax.sampling import TextToMotion
    from t2m_jax.sampling.request import SamplingOptions

    options = read_record(SamplingOptions, args)
    track = TRACKS[args.track]
    evaluator = load_trained_evaluator(args.evaluator or track.evaluator)
    dataset = open_dataset(args.data or track.data)
    check_track(dataset, args.track)
    model = TextToMotion.load(args.model)
    unit = math.lcm(UNIT, model.config.tokenizer.downsample)
    task = make_task(dataset, evaluator, find_protocol(PROTOCOL), split=args.split, seed=args.seed, unit=unit)
    source = make_generation(model, task.samples.clips, options=options)
    # Finished repeats are kept there, so that an interrupted benchmark continues.
    partial = None if args.json is None else Path(f"{args.json}.partial")
    report = evaluate(task, source, num_repeats=args.num_repeats, model=args.model, partial=partial)
    report = dataclasses.replace(report, following=measure_following(model, options))
    table = make_table([report], [source.kind], measures="benchmark")
    sys.stdout.write(format_table(table, style="terminal") + "\n\n")
    for group, found in (report.following or {}).items():
        sys.stdout.write(f"{group}: {found.right} of {found.samples} did what was asked\n")
    if args.json is not None and partial is not None:
        save_report(args.json, report)
        partial.unlink(missing_ok=True)
