"""Write a model for programs without Python: `t2m export onnx MODEL DIR` or `t2m export page MODEL DIR`.

The folder of `onnx` has ONNX graphs, the tokenizer of sentences, and a manifest that says how to use them.
docs/engines.md describes them, with a small sampler. That of `page` is a web page that runs the graphs in
the browser (docs/page.md). Both need the extra `onnx`: pip install 't2m-jax[onnx]'.
"""

import argparse
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from t2m_jax.cli.options import MODEL_HELP, show_next, subcommand_adder

if TYPE_CHECKING:
    from t2m_jax.checkpoints.bundle import Bundle


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the sub-commands and their options."""
    add = subcommand_adder(parser)
    onnx = add(run_onnx, "write ONNX graphs, which onnxruntime, Unity and others run")
    page = add(run_page, "write a web page that makes motions in the browser, without a server")
    for command in (onnx, page):
        command.add_argument("model", metavar="MODEL", help=MODEL_HELP)
        command.add_argument("destination", type=Path, metavar="DIR", help="folder to write")


def run(args: argparse.Namespace) -> None:
    """Runs a sub-command."""
    args.run_command(args)


def run_onnx(args: argparse.Namespace) -> None:
    """Writes the folder of graphs, and prints its name and the next command."""
    from t2m_jax.export.onnx.folder import export_onnx

    _export(args, export_onnx)
    show_next(f"run the graphs of {shlex.quote(str(args.destination))} as in docs/engines/sampler.py")


def run_page(args: argparse.Namespace) -> None:
    """Writes the folder of the page, and prints its name and the next command."""
    from t2m_jax.export.page.site import export_page

    _export(args, export_page)
    show_next(f"python -m http.server --directory {shlex.quote(str(args.destination))}")


def _export(args: argparse.Namespace, export: Callable[[Path, "Bundle"], None]) -> None:
    from t2m_jax.checkpoints.model import load_model
    from t2m_jax.export.onnx.convert import check_extra
    from t2m_jax.files.writing import check_new

    # Before the weights are read, which takes longest.
    check_extra()
    check_new(args.destination)
    export(args.destination, load_model(args.model))
    sys.stdout.write(f"{args.destination}\n")
