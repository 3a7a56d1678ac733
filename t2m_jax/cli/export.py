"""Write a model for programs without Python: `t2m export onnx MODEL DIR`.

The folder has ONNX graphs, the tokenizer of sentences, and a manifest that says how to use them. docs/engines.md
describes them, with a sampler of a hundred lines. This needs the extra `onnx`: pip install 't2m-jax[onnx]'.
"""

import argparse
import shlex
import sys
from pathlib import Path

from t2m_jax.cli.options import MODEL_HELP, show_next, subcommand_adder


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the sub-commands and their options."""
    onnx = subcommand_adder(parser)(run_onnx, "write ONNX graphs, which onnxruntime, Unity and others run")
    onnx.add_argument("model", metavar="MODEL", help=MODEL_HELP)
    onnx.add_argument("destination", type=Path, metavar="DIR", help="folder to write")


def run(args: argparse.Namespace) -> None:
    """Runs a sub-command."""
    args.run_command(args)


def run_onnx(args: argparse.Namespace) -> None:
    """Writes the folder, and prints its name and the next command."""
    from t2m_jax.checkpoints.model import load_model
    from t2m_jax.export.onnx.convert import check_extra
    from t2m_jax.export.onnx.folder import export_onnx
    from t2m_jax.files.writing import check_new

    # Before the weights are read, which takes longest.
    check_extra()
    check_new(args.destination)
    export_onnx(args.destination, load_model(args.model))
    sys.stdout.write(f"{args.destination}\n")
    show_next(f"run the graphs of {shlex.quote(str(args.destination))} as in docs/engines/sampler.py")
