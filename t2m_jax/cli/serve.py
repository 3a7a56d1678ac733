"""Open the studio, a page to make motions in: `t2m serve`, then open the address in a browser."""

import argparse
import os
import sys

from t2m_jax.cli.options import add_model_argument
from t2m_jax.errors import UserError

TOKEN_VARIABLE = "T2M_JAX_TOKEN"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    add_model_argument(parser)
    parser.add_argument("--port", type=int, default=8000, help="0 chooses a free one (default: 8000)")
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to listen on; others than this computer's own need a token"
    )
    parser.add_argument(
        "--token", help=f"what requests must bring (default: ${TOKEN_VARIABLE}, which other users cannot see)"
    )
    parser.add_argument("--batch", type=int, default=32, help="motions that are generated together (default: 32)")
    parser.add_argument("--queue", type=int, default=64, help="requests that may wait (default: 64)")


def run(args: argparse.Namespace) -> None:
    """Serves until Ctrl-C or SIGTERM."""
    try:
        import uvicorn  # noqa: F401 - only whether it is there

        from t2m_jax.serving.app import LOOPBACK
        from t2m_jax.serving.serve import serve
    except ModuleNotFoundError as error:
        raise UserError(f"t2m serve: needs {error.name}; pip install 't2m-jax[serve]'") from None

    # Options of a process can be seen by all users of a computer, variables cannot.
    token = args.token or os.environ.get(TOKEN_VARIABLE) or None
    # Whoever reaches the server can keep it busy, so an open one must be meant.
    if args.host not in LOOPBACK and not token:
        raise UserError(f"--host: {args.host} can be reached by others; set a token in ${TOKEN_VARIABLE} or --token")
    for name, most in (("batch", 1024), ("queue", 10_000)):
        if not 1 <= getattr(args, name) <= most:
            raise UserError(f"--{name}: {getattr(args, name)} is not a whole number from 1 to {most}")
    if not 0 <= args.port < 2**16:
        raise UserError(f"--port: {args.port} is not a number from 0 to 65535")
    sys.stderr.write(f"loading {args.model} ...\n")
    serve(
        args.model,
        host=args.host,
        port=args.port,
        token=token,
        batch_size=args.batch,
        max_waiting=args.queue,
        on_ready=lambda address: print(address, flush=True),
    )
