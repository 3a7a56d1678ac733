"""Measure how fast this machine trains, samples, evaluates and reads data.

Figures are medians; compile time is separate. Shares of a peak refer to products and memory rates that were measured on
this machine just before. `--json F` stores the figures. `t2m bench COMMAND --help` describes the options of each.
"""

import argparse
import contextlib
import itertools
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from t2m_jax.cli.options import add_model_argument, show_next, subcommand_adder
from t2m_jax.errors import UserError
from t2m_jax.files.writing import check_output, claim

if TYPE_CHECKING:
    from t2m_jax.bench.record import BenchResult, Peaks


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the sub-commands and their options."""
    add = subcommand_adder(parser)
    train = add(run_train, "measure updates of tokenizers and generators, on random data")
    sample = add(run_sample, "measure sampling")
    evaluate = add(run_evaluate, "measure the networks of an evaluation")
    data = add(run_data, "measure batches and opening a data set")
    everything = add(run_all, "measure all of this")
    for command in (train, sample, evaluate, data, everything):
        _add_shared_arguments(command)
    for command in (train, evaluate):
        command.add_argument(
            "--size", choices=("full", "demo"), default="full", help="published or demo (default: full)"
        )
    _add_train_arguments(train)
    add_model_argument(sample)
    full = "instead of a model: random weights of the published sizes (see --kind)"
    sample.add_argument("--full-size", action="store_true", help=full)
    kinds = ("gpt", "hifigpt")
    sample.add_argument("--kind", nargs="+", choices=kinds, default=kinds, help="with --full-size (default: both)")
    sample.add_argument("--batch", type=int, nargs="+", default=[1, 32], help="batch sizes (default: 1 32)")
    sample.add_argument("--codes", type=int, help="rows of codes per motion (default: the model's most, up to 50)")
    evaluate.add_argument("--batch", type=int, default=128, help="motions embedded together (default: 128)")
    data.add_argument("--batch", type=int, default=256, help="windows per batch (default: 256)")
    for command in (data, everything):
        command.add_argument("--data", metavar="DIR", help="also open this data set")


def _add_shared_arguments(parser: argparse.ArgumentParser) -> None:
    devices = "numbers of devices, each measured; on a CPU they are virtual and share its cores (default: all devices)"
    parser.add_argument("--devices", type=int, nargs="+", metavar="N", help=devices)
    repeats = "timed calls after the first; the median is shown (default: 3)"
    parser.add_argument("--repeats", type=int, default=3, help=repeats)
    parser.add_argument("--json", type=Path, metavar="F", help="also write the figures to this file")


def _add_train_arguments(parser: argparse.ArgumentParser) -> None:
    kinds = ("vqvae", "gpt", "rvqvae", "hifigpt")
    parser.add_argument("--kind", nargs="+", choices=kinds, default=["vqvae", "gpt"], help="default: vqvae gpt")
    parser.add_argument("--batch", type=int, help="default: of the recipe, but 16 for a full generator on a CPU")
    parser.add_argument("--precision", choices=("float32", "bfloat16"), default="float32", help="default: float32")
    parser.add_argument("--steps-per-call", type=int, default=1, help="updates of one call (default: 1)")
    parser.add_argument("--remat", action="store_true", help="compute values of a generator again for the gradient")
    parser.add_argument("--num-parts", type=int, default=1, help="parts of a batch of a generator (default: 1)")


def run(args: argparse.Namespace) -> None:
    """Runs the chosen sub-command."""
    # A wrong number would only show after minutes of measurement. Not every sub-command has all of them.
    numbers = ("codes", "repeats", "batch", "devices", "steps_per_call", "num_parts")
    for name in numbers:
        value = getattr(args, name, None)
        smallest = min(value) if isinstance(value, list) else value
        if smallest is not None and smallest < 1:
            raise UserError(f"bench: --{name.replace('_', '-')} {smallest} is not a whole number above 0")
    args.devices = _use_devices(args.devices)
    args.run_command(args)


def run_train(args: argparse.Namespace) -> None:
    """Prints the speed of training."""
    from t2m_jax.bench import train

    options = train.Options(args.batch, args.precision, args.steps_per_call, args.remat, args.num_parts)

    def measure(peaks: "Peaks") -> "list[BenchResult]":
        try:
            configs = [train.make_training(kind, args.size, options, devices=peaks.num_devices) for kind in args.kind]
        except ValueError as error:  # an option does not fit the batch
            raise UserError(f"bench: {error}") from error
        return [
            train.benchmark_training(config, size=args.size, peaks=peaks, repeats=args.repeats) for config in configs
        ]

    _report(args, measure)
    show_next("t2m bench sample --full-size")


def run_sample(args: argparse.Namespace) -> None:
    """Prints the speed of sampling."""
    from t2m_jax.bench.probes import first_devices
    from t2m_jax.bench.sample import MeasuredSystem, benchmark_sampling, check_sampling, full_size_systems
    from t2m_jax.sampling.pipeline import TextToMotion

    if args.full_size:
        systems = full_size_systems(args.kind)
    else:
        model = TextToMotion.load(args.model)
        scale = model.parts.guidance_scale()
        parts = (model.config.generator, model.config.tokenizer, model.variables)
        # A scale of 1 is sampled without the second half of the batch that guidance needs (see `ModelParts`).
        systems = [MeasuredSystem(Path(args.model).name, *parts, None if scale == 1 else scale)]
    configs = [system.generator for system in systems]
    check_sampling(configs, batches=args.batch, num_codes=args.codes, devices=args.devices)

    def measure(peaks: "Peaks") -> "list[BenchResult]":
        mesh = first_devices(peaks.num_devices)
        shared = {"num_codes": args.codes, "mesh": mesh, "peaks": peaks, "repeats": args.repeats}
        pairs = itertools.product(systems, args.batch)
        return [benchmark_sampling(system, batch=batch, **shared) for system, batch in pairs]

    _report(args, measure)
    show_next("t2m bench sample" + ("" if args.full_size else " --full-size"))


def run_evaluate(args: argparse.Namespace) -> None:
    """Prints the speed of the evaluator's networks."""
    from t2m_jax.bench import evaluate
    from t2m_jax.bench.probes import first_devices

    config = evaluate.EvaluatorConfig() if args.size == "full" else evaluate.DEMO_SIZES

    def measure(peaks: "Peaks") -> "list[BenchResult]":
        mesh = first_devices(peaks.num_devices)
        return evaluate.benchmark_embedding(
            config, size=args.size, mesh=mesh, peaks=peaks, batch=args.batch, repeats=args.repeats
        )

    _report(args, measure)
    show_next("t2m bench data")


def run_data(args: argparse.Namespace) -> None:
    """Prints the speed of reading data."""
    from t2m_jax.bench.data import benchmark_opening, benchmark_windows

    def measure(peaks: "Peaks") -> "list[BenchResult]":
        count = peaks.num_devices
        shared = {"peaks": peaks, "batch": args.batch, "repeats": args.repeats}
        rows = [benchmark_windows(num_devices=count, **shared)]
        # On one device, a sharded bank is the same as a whole one.
        if count > 1:
            rows.append(benchmark_windows(num_devices=count, bank="sharded", **shared))
        return rows if args.data is None else [*rows, benchmark_opening(args.data, repeats=args.repeats)]

    _report(args, measure)
    show_next("t2m bench all --json performance.json")


def run_all(args: argparse.Namespace) -> None:
    """Prints the speed of everything."""
    from t2m_jax.bench.run import measure_all

    _report(args, lambda peaks: measure_all(peaks, data=args.data, repeats=args.repeats))
    show_next("t2m bench sample --full-size")


def _report(args: argparse.Namespace, measure: "Callable[[Peaks], Sequence[BenchResult]]") -> None:
    """Measures, prints the figures and stores them."""
    from t2m_jax.bench import probes, report_text, run, save_report

    # Whatever is wrong with the file is said before the measurement, which may take minutes.
    outputs = [] if args.json is None else [check_output(args.json)]
    with claim(outputs):
        report = run.make_report(measure, devices=args.devices, probe=probes.measure_peaks)
        width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
        sys.stdout.write(f"{report_text(report, width=width)}\n")
        for output in outputs:
            save_report(output, report)


def _use_devices(counts: list[int] | None) -> list[int]:
    """Returns the numbers of devices to measure. On a CPU, this makes as many virtual devices."""
    import jax

    jax.config.update("jax_enable_compilation_cache", False)  # so that compile times are real
    if counts is not None:
        with contextlib.suppress(RuntimeError):  # raised if devices are in use; `first_devices` checks the number
            jax.config.update("jax_num_cpu_devices", max(counts))
    return counts or [jax.device_count()]
