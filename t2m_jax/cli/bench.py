"""Measure speed: `t2m bench sample [--model M | --full-size] [--batch 1 32]` prints milliseconds a code."""

import argparse
import sys


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    parser.add_argument("what", choices=("sample",), help="what to measure")
    parser.add_argument("--model", default="demo", help="bundled name, bundle folder or run folder (default: demo)")
    parser.add_argument(
        "--full-size",
        action="store_true",
        help="instead of a model: the published GPT's size (18 layers, 1024, 16 heads) with random weights",
    )
    parser.add_argument("--batch", type=int, nargs="+", default=[1, 32], help="batch sizes (default: 1 32)")
    parser.add_argument("--codes", type=int, default=50, help="codes a motion (default: 50)")
    parser.add_argument("--repeats", type=int, default=3, help="runs after the first; the median counts (default: 3)")


def run(args: argparse.Namespace) -> None:
    """Prints one line a batch size."""
    from t2m_jax.errors import UserError
    from t2m_jax.models.motion_gpt import MotionGptConfig
    from t2m_jax.sampling.benchmark import benchmark_decoding, random_gpt_variables
    from t2m_jax.sampling.pipeline import TextToMotion

    for name in ("codes", "repeats"):
        if getattr(args, name) < 1:
            raise UserError(f"bench: --{name} {getattr(args, name)} is not a whole number above 0")
    if min(args.batch) < 1:
        raise UserError(f"bench: --batch {min(args.batch)} is not a whole number above 0")
    if args.full_size:
        config = MotionGptConfig()
        variables = random_gpt_variables(config)
    else:
        model = TextToMotion.load(args.model)
        config, variables = model.config.gpt, model.variables["gpt"]
    if args.codes > config.max_codes:
        raise UserError(f"bench: --codes {args.codes} is more than the model's {config.max_codes}")
    for batch in args.batch:
        timing = benchmark_decoding(config, variables, batch=batch, num_codes=args.codes, repeats=args.repeats)
        sys.stdout.write(
            f"batch {batch:4}: {timing.milliseconds_per_code:8.2f} ms a code, "
            f"{timing.milliseconds_per_step:8.2f} ms a step, compiled in {timing.compile_seconds:.1f} s\n"
        )
