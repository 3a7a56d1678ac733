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

from t2m_jax.cli.allocation import keep_freed_memory
from t2m_jax.cli.options import add_model_argument, positive, show_next, subcommand_adder
from t2m_jax.files.writing import check_output, claim

if TYPE_CHECKING:
    from t2m_jax.bench.record import BenchResult, Peaks

    Measure = Callable[[Peaks], Sequence[BenchResult]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the sub-commands and their options."""
    add = subcommand_adder(parser)
    train = add(run_train, "measure updates of tokenizers and generators, on random data")
    sample = add(run_sample, "measure sampling")
    evaluate = add(run_evaluate, "measure the networks of an evaluation")
    data = add(run_data, "measure batches and opening a data set")
    everything = add(run_all, "measure all of this")
    for command in (train, sample, evaluate, data, everything):
        devices = "numbers of devices, each measured; on a CPU they are virtual and share its cores (default: all)"
        command.add_argument("--devices", type=positive, nargs="+", metavar="N", help=devices)
        command.add_argument("--json", type=Path, metavar="F", help="also write the figures to this file")
    kinds = ("vqvae", "gpt", "rvqvae", "hifigpt")
    train.add_argument("--kind", nargs="+", choices=kinds, default=["vqvae", "gpt"], help="default: vqvae gpt")
    train.add_argument("--size", choices=("full", "demo"), default="full", help="published or demo (default: full)")
    train.add_argument("--batch", type=positive, help="default: of the recipe, but 16 for a full generator on a CPU")
    train.add_argument("--precision", choices=("float32", "bfloat16"), default="float32", help="default: float32")
    add_model_argument(sample)
    full = "instead of a model: random weights of the published sizes of both systems"
    sample.add_argument("--full-size", action="store_true", help=full)
    sample.add_argument("--batch", type=positive, nargs="+", default=[1, 32], help="batch sizes (default: 1 32)")
    for command in (data, everything):
        command.add_argument("--data", metavar="DIR", help="also open this data set")


def run(args: argparse.Namespace) -> None:
    """Measures, prints the figures and stores them."""
    keep_freed_memory()  # as a training does
    from t2m_jax.bench import report_text, save_report
    from t2m_jax.bench.probes import make_report

    devices = args.devices = _use_devices(args.devices)
    outputs = [] if args.json is None else [check_output(args.json)]
    with claim(outputs):
        report = make_report(args.run_command(args), devices=devices)
        width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
        sys.stdout.write(f"{report_text(report, width=width)}\n")
        for output in outputs:
            save_report(output, report)
    show_next("t2m bench all --json performance.json" if args.json is None else "t2m bench sample --full-size")


def run_train(args: argparse.Namespace) -> "Measure":
    """Returns what measures training."""
    from t2m_jax.bench.train import benchmark_training, make_training

    def measure(peaks: "Peaks") -> "list[BenchResult]":
        shared = {"batch": args.batch, "precision": args.precision, "devices": peaks.num_devices}
        configs = [make_training(kind, args.size, **shared) for kind in args.kind]
        return [benchmark_training(config, size=args.size, peaks=peaks) for config in configs]

    return measure


def run_sample(args: argparse.Namespace) -> "Measure":
    """Returns what measures sampling."""
    from t2m_jax.bench.probes import first_devices
    from t2m_jax.bench.sample import MeasuredSystem, benchmark_sampling, full_size_systems
    from t2m_jax.sampling.pipeline import TextToMotion

    for count, batch in itertools.product(args.devices, args.batch):
        first_devices(count, batch=batch)
    if args.full_size:
        systems = full_size_systems()
    else:
        model = TextToMotion.load(args.model)
        scale = model.parts.guidance_scale()
        parts = (model.config.generator, model.config.tokenizer, model.variables)
        # A scale of 1 is sampled without the second half of the batch that guidance needs (see `ModelParts`).
        systems = [MeasuredSystem(Path(args.model).name, *parts, None if scale == 1 else scale)]
    pairs = list(itertools.product(systems, args.batch))
    return lambda peaks: [benchmark_sampling(system, batch=batch, peaks=peaks) for system, batch in pairs]


def run_evaluate(_: argparse.Namespace) -> "Measure":
    """Returns what measures the evaluator's networks."""
    from t2m_jax.bench.evaluate import benchmark_embedding
    from t2m_jax.models.evaluator import EvaluatorConfig

    return lambda peaks: benchmark_embedding(EvaluatorConfig(), peaks=peaks)


def run_data(args: argparse.Namespace) -> "Measure":
    """Returns what measures reading data."""
    from t2m_jax.bench.data import benchmark_opening, benchmark_windows

    folders = [] if args.data is None else [args.data]
    return lambda peaks: [benchmark_windows(peaks=peaks), *map(benchmark_opening, folders)]


def run_all(args: argparse.Namespace) -> "Measure":
    """Returns what measures everything at full size."""
    import jax

    def with_options(**options: object) -> argparse.Namespace:
        return argparse.Namespace(**vars(args) | options)

    # Products of bfloat16 are slow on most CPUs.
    precisions = ("float32",) if jax.default_backend() == "cpu" else ("float32", "bfloat16")
    shared = {"kind": ("vqvae", "gpt"), "size": "full", "batch": None}
    measures = [run_train(with_options(**shared, precision=precision)) for precision in precisions]
    batches = [batch for batch in (1, 32) if all(batch % count == 0 for count in args.devices)]
    measures += [run_sample(with_options(full_size=True, batch=batches)), run_evaluate(args), run_data(args)]
    return lambda peaks: [row for measure in measures for row in measure(peaks)]


def _use_devices(counts: list[int] | None) -> list[int]:
    """Returns the numbers of devices to measure. On a CPU, this makes as many virtual devices."""
    import jax

    jax.config.update("jax_enable_compilation_cache", False)  # so that compile times are real
    if counts is not None:
        with contextlib.suppress(RuntimeError):  # raised if devices are in use; `first_devices` checks the number
            jax.config.update("jax_num_cpu_devices", max(counts))
    return counts or [jax.device_count()]
