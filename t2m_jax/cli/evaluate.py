"""Measure a model: `t2m evaluate {reconstruction,generation,prompts} --model M [--data DIR] [--json F]`.

`reconstruction` puts every clip of a split through the VQ-VAE; `generation` compares motion generated from a split's
captions with real motion, in the space of an evaluator and by a named protocol; `prompts` generates from held-out
sentences of the Bandai-Namco contents and tests each motion against a kinematic rule. `compare A.json B.json` sets two
reports of `generation` beside each other, `table A.json B.json ...` puts any number into one table.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from t2m_jax.cli import evaluate_report

if TYPE_CHECKING:
    from t2m_jax.data.folder import Clip, Dataset
    from t2m_jax.evaluation.sources import Maker

LABELS = {
    "mpjpe_mm": "MPJPE, mm (root-aligned)",
    "mpjpe_median_clip_mm": "MPJPE of the median clip, mm",
    "codebook_usage": "codebook usage",
    "perplexity": "perplexity",
    "num_clips": "clips",
    "num_frames": "frames",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    kinds = ("reconstruction", "generation", "prompts", "compare", "table")
    parser.add_argument("what", choices=kinds, help="what to measure")
    parser.add_argument("reports", nargs="*", metavar="REPORT", help="reports of generation (compare: two; table)")
    parser.add_argument("--model", default="demo", help="bundled name, bundle folder or run folder (default: demo)")
    parser.add_argument("--data", default=None, metavar="DIR", help="data-set folder (not for prompts)")
    parser.add_argument("--evaluator", default=None, metavar="E", help="evaluator: folder or run (generation)")
    parser.add_argument("--protocol", default="t2m-gpt", help="t2m-gpt, text-to-motion, momask or strict (generation)")
    parser.add_argument("--num-repeats", type=int, default=20, help="how often (generation; default: 20)")
    parser.add_argument("--seed", type=int, default=0, help="of all that is drawn (generation; default: 0)")
    parser.add_argument("--greedy", action="store_true", help="take the likeliest code, draw none (generation)")
    parser.add_argument("--split", default="test", help="split to measure on (default: test)")
    parser.add_argument("--num-seeds", type=int, default=20, help="samples a content (prompts; default: 20)")
    parser.add_argument("--json", default=None, metavar="F", help="also write the figures to this file")
    evaluate_report.add_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Prints a table and writes the JSON file."""
    from t2m_jax.errors import UserError
    from t2m_jax.evaluation.report.record import check_output, save_json
    from t2m_jax.sampling.compilation import use_compilation_cache

    if args.what in ("compare", "table"):
        {"compare": _compare, "table": evaluate_report.run_table}[args.what](args)
        return
    if args.reports:
        raise UserError(f"evaluate {args.what}: unknown argument '{args.reports[0]}'")
    if args.what != "prompts" and args.data is None:
        raise UserError(f"evaluate {args.what}: --data is missing; give the data-set folder")
    if args.what == "generation" and args.evaluator is None:
        raise UserError("evaluate generation: --evaluator is missing; train one with `t2m train evaluator`")
    if args.num_repeats < 1:
        raise UserError(f"evaluate generation: --num-repeats {args.num_repeats} is not a whole number above 0")
    if args.num_seeds < 1:
        raise UserError(f"evaluate prompts: --num-seeds {args.num_seeds} is not a whole number above 0")
    if args.json:
        check_output(Path(args.json))
    if args.html:
        evaluate_report.check_options(args)
    use_compilation_cache()
    figures = {"reconstruction": _reconstruction, "generation": _generation, "prompts": _prompts}[args.what](args)
    if args.json:
        save_json(Path(args.json), figures)
        Path(f"{args.json}.partial").unlink(missing_ok=True)


def _reconstruction(args: argparse.Namespace) -> dict[str, Any]:
    from t2m_jax.checkpoints.vqvae import load_vqvae
    from t2m_jax.data.folder import open_dataset
    from t2m_jax.evaluation.reconstruction import evaluate_reconstruction
    from t2m_jax.evaluation.sources import Reconstruction

    vqvae, dataset = load_vqvae(Path(args.model)), open_dataset(args.data)
    report = evaluate_reconstruction(vqvae, dataset, split=args.split)
    for name, label in LABELS.items():
        value = getattr(report, name)
        sys.stdout.write(f"{label:32} {value:,.3f}\n" if isinstance(value, float) else f"{label:32} {value:,}\n")
    if args.evaluator is None:
        return report._asdict()
    sys.stdout.write("\n")
    return report._asdict() | _by_protocol(args, dataset, lambda _: Reconstruction(vqvae))


def _compare(args: argparse.Namespace) -> None:
    from t2m_jax.errors import UserError
    from t2m_jax.evaluation.report.comparison import compare_reports, comparison_table
    from t2m_jax.evaluation.report.record import load_report

    if len(args.reports) != 2:
        raise UserError(f"evaluate compare: give two reports, not {len(args.reports)}")
    differences = compare_reports(*(load_report(Path(path)) for path in args.reports))
    sys.stdout.write(comparison_table([Path(path).stem for path in args.reports], differences) + "\n")


def _generation(args: argparse.Namespace) -> dict[str, Any]:
    from t2m_jax.data.folder import open_dataset
    from t2m_jax.evaluation.sources import make_generation
    from t2m_jax.evaluation.task import check_width
    from t2m_jax.sampling import Greedy, Temperature, TextToMotion

    model, dataset = TextToMotion.load(args.model), open_dataset(args.data)
    check_width("the model", model.skeleton.feature_dim, dataset)
    strategy = Greedy() if args.greedy else Temperature()
    return _by_protocol(args, dataset, lambda clips: make_generation(model, strategy, clips))


def _by_protocol(
    args: argparse.Namespace, dataset: "Dataset", make_maker: "Callable[[Sequence[Clip]], Maker]"
) -> dict[str, Any]:
    """Returns the report of what a maker makes, after printing its table."""
    from t2m_jax.checkpoints.evaluator import load_evaluator_bundle
    from t2m_jax.evaluation.protocols import find_protocol
    from t2m_jax.evaluation.run import evaluate
    from t2m_jax.evaluation.task import make_subject

    protocol, evaluator = find_protocol(args.protocol), load_evaluator_bundle(args.evaluator)
    subject = make_subject(dataset, evaluator, protocol, split=args.split, seed=args.seed)
    header = {
        "protocol": protocol.name,
        "model": args.model,
        "data": dataset.info.name,
        "split": args.split,
        "num_samples": len(subject.samples.clips),
        "left_out_for_shared_source": subject.samples.shared,
        "evaluator": evaluator.fingerprint,
        "sampling": {"generation": "greedy" if args.greedy else "sampled"}.get(args.what, "none"),
        "seed": args.seed,
    }
    partial = Path(f"{args.json}.partial") if args.json else None
    maker = make_maker(subject.samples.clips)
    report = evaluate(subject, maker, num_repeats=args.num_repeats, header=header, partial=partial)
    told = (f"{name} {value}" for name, value in header.items() if value is not None)
    sys.stdout.write(", ".join(told) + "\n\n")
    evaluate_report.print_report(report)
    if args.html:
        evaluate_report.write_page(Path(args.html), report, subject, maker)
    return report


def _prompts(args: argparse.Namespace) -> dict[str, Any]:
    from t2m_jax.evaluation.prompt_following import evaluate_prompt_following, markdown_table
    from t2m_jax.sampling import TextToMotion

    model = TextToMotion.load(args.model)
    results = evaluate_prompt_following(
        lambda sentence, seed: model.generate(sentence, seed=seed)[0], num_seeds=args.num_seeds
    )
    sys.stdout.write(markdown_table(results) + "\n")
    right, total = sum(row.num_right for row in results), sum(row.num_samples for row in results)
    return {
        "prompt_following": right / total,
        "num_samples": total,
        "contents": {
            row.content: {"right": row.num_right, "samples": row.num_samples, "failures": list(row.failures)}
            for row in results
        },
    }
