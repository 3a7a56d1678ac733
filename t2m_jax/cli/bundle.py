"""Pack run folders into one model to share: `t2m bundle RUN... DIR`. The run of an evaluator becomes an evaluator.

`t2m bundle MODEL TRAINED DIR --mean 0.7` writes a model between two, of which the second was trained on from the first.

With `--push user/name`, the bundle is also uploaded to the Hugging Face hub. `t2m bundle DIR --push user/name` uploads
a bundle that was packed before. The card must have a license in its metadata, such as `license: mit`.
"""

import argparse
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from t2m_jax.cli.options import show_next
from t2m_jax.errors import UserError, naming

if TYPE_CHECKING:
    from t2m_jax.checkpoints import Bundle
    from t2m_jax.checkpoints.hub import HubName


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    paths = (
        "run folder of a generator, which contains its tokenizer; with --mean any model; at last, the folder to write"
    )
    parser.add_argument("paths", nargs="+", metavar="PATH", help=paths)
    parser.add_argument("--card", default=None, metavar="FILE", help="model card (Markdown) to include")
    mean = "write the mean of two models; the second, which was trained on from the first, counts SHARE (0 to 1)"
    parser.add_argument("--mean", type=float, default=None, metavar="SHARE", help=mean)
    parser.add_argument("--export-official", action="store_true", help="also write files for the original code")
    name = "upload the bundle to this repository of the hub; with user/name@branch, to this branch"
    parser.add_argument("--push", default=None, metavar="user/name", help=name)
    parser.add_argument("--private", action="store_true", help="with --push: only you can see the repository")


def run(args: argparse.Namespace) -> None:
    """Writes or pushes the bundle, and prints its name and the next command."""
    from t2m_jax.checkpoints.evaluator import EVALUATOR_CONFIG
    from t2m_jax.checkpoints.hub import hub_name

    # The destination is the last path, as with `cp`, which argparse cannot declare with two arguments.
    *runs, folder = args.paths
    if len(runs) == 1 and (Path(runs[0]) / EVALUATOR_CONFIG).is_file():
        _pack_evaluator(args, Path(runs[0]), Path(folder))
        return
    name = None if args.push is None else hub_name(args.push)
    if name is None and args.private:
        raise UserError("--private: is for --push; without it, nothing is uploaded")
    if not runs and (name is None or args.card or args.export_official or args.mean is not None):
        raise UserError("bundle: give the runs and then the folder to write; only --push takes a bundle alone")
    if runs:
        _pack(args, runs, Path(folder), name)
    model = folder
    if name is not None:
        from t2m_jax.checkpoints.hub_models import push_bundle

        sys.stdout.write(f"{push_bundle(Path(folder), name, private=args.private)}\n")
        model = f"{name}"
    show_next(shlex.join(["t2m", "generate", "a person walks forward", "--model", model]))


def _pack_evaluator(args: argparse.Namespace, run_folder: Path, destination: Path) -> None:
    """Writes the folder of an evaluator with the best weights of its run."""
    from t2m_jax.checkpoints import load_trained_evaluator, save_evaluator

    if args.card or args.push or args.private or args.export_official or args.mean is not None:
        options = "--mean, --card, --push, --private, --export-official"
        raise UserError(f"{run_folder}: is an evaluator; {options} are for models")
    save_evaluator(destination, load_trained_evaluator(run_folder))
    sys.stdout.write(f"{destination}\n")
    show_next(shlex.join(["t2m", "check", f"{destination}"]))


def _pack(args: argparse.Namespace, runs: list[str], destination: Path, name: "HubName | None") -> None:
    """Writes the folder; nothing is written if it is to be pushed to `name` and is not complete enough."""
    from t2m_jax.checkpoints.bundle import default_card, write_bundle
    from t2m_jax.checkpoints.hub_models import check_shareable
    from t2m_jax.checkpoints.official import export_official
    from t2m_jax.checkpoints.run import is_run
    from t2m_jax.checkpoints.text_encoder import included_encoder
    from t2m_jax.files.reading import load_text
    from t2m_jax.files.writing import atomic_folder

    # The folder appears only when it is complete, also if a card is missing or the disk is full.
    with atomic_folder(destination) as folder:
        bundle, source = _read(runs, args.mean)
        if args.card:
            bundle = bundle._replace(card=load_text(Path(args.card)))
        elif is_run(source):
            bundle = bundle._replace(card=default_card(source))
        write_bundle(folder, bundle, card=bundle.card, encoder=included_encoder(bundle.config.text_encoder))
        if name is not None:
            with naming(destination):
                check_shareable(folder)
        if args.export_official:
            export_official(folder / "official", bundle)
    sys.stdout.write(f"{destination}\n")


def _read(paths: list[str], share: float | None) -> "tuple[Bundle, Path]":
    """Returns the model of some runs, or with a share the mean of two models, and the folder of its card."""
    from t2m_jax.checkpoints.averaging import mean_of_models
    from t2m_jax.checkpoints.model import load_model, load_runs

    if share is None:
        run_folder, bundle = load_runs([Path(path) for path in paths])
        return bundle, run_folder
    if len(paths) != 2:
        raise UserError("--mean: give two models and then the folder to write")
    return mean_of_models(load_model(paths[0]), load_model(paths[1]), share), Path(paths[1])
