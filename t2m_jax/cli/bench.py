"""Measure speed: `t2m bench sample [--model M | --full-size] [--batch 1 32]` prints milliseconds per code."""

import argparse
import sys

from t2m_jax.cli.next_step import show_next


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    parser.add_argument("what", choices=("sample",), help="what to measure")
    parser.add_argument("--model", default="demo", help="bundled name, bundle folder or run folder (default: demo)")
    parser.add_argument(
        "--full-size",
        action="store_true",
        help="instead of the model's weights: random weights of the size that its kind was published with",
    )
    parser.add_argument("--batch", type=int, nargs="+", default=[1, 32], help="batch sizes (default: 1 32)")
    parser.add_argument("--codes", type=int, default=50, help="codes per motion (default: 50)")
    parser.add_argument("--repeats", type=int, default=3, help="runs after the first; the median is shown (default: 3)")


def run(args: argparse.Namespace) -> None:
    """Prints one line per batch size."""
    from t2m_jax.errors import UserError
    from t2m_jax.sampling.bench import benchmark_sampling, random_variables
    from t2m_jax.sampling.pipeline import TextToMotion

    for name, number in (("codes", args.codes), ("repeats", args.repeats), ("batch", min(args.batch))):
        if number < 1:
            raise UserError(f"bench: --{name} {number} is not a whole number above 0")
    model = TextToMotion.load(args.model)
    config, variables = model.config.generator, model.variables["generator"]
    if args.full_size:
        config = type(config)()
        variables = random_variables(config)
    if args.codes > config.max_codes:
        raise UserError(f"bench: --codes {args.codes} is more than the model's {config.max_codes}")
    for batch in args.batch:
        timing = benchmark_sampling(config, variables, batch=batch, num_codes=args.codes, repeats=args.repeats)
        sys.stdout.write(
            f"batch {batch:4}: {timing.milliseconds_per_code:8.2f} ms per code, "
            f"{timing.milliseconds_per_step:8.2f} ms per step, compiled in {timing.compile_seconds:.1f} s\n"
        )
    show_next("t2m bench sample" + ("" if args.full_size else " --full-size"))
