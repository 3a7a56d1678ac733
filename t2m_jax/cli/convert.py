"""Turn published weights into a model, and models into the published form.

`t2m convert official --vqvae F --gpt F --mean F --std F DIR` makes a bundle of the files that T2M-GPT's authors
publish, `t2m convert official --evaluator F --mean F --std F --words F --word-vectors F DIR` an evaluator of those of
text-to-motion. `t2m convert official --export-official MODEL DIR` writes any model's weights under the names of their
code.
"""

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from t2m_jax.checkpoints.bundle import Bundle
    from t2m_jax.checkpoints.clip import TrainedClip

_FILES = ("vqvae", "gpt", "mean", "std")
_EVALUATOR_FILES = ("evaluator", "mean", "std", "words", "word_vectors")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    parser.add_argument("source", choices=["official"], help="whose weights: those of the original PyTorch code")
    parser.add_argument("destination", type=Path, metavar="DIR", help="folder to write")
    parser.add_argument("--vqvae", type=Path, metavar="FILE", help="VQ-VAE: .pth, .tar or .safetensors")
    parser.add_argument("--gpt", type=Path, metavar="FILE", help="GPT: .pth, .tar or .safetensors")
    parser.add_argument("--mean", type=Path, metavar="FILE", help="mean.npy that was published with them")
    parser.add_argument("--std", type=Path, metavar="FILE", help="std.npy that was published with them")
    parser.add_argument("--evaluator", type=Path, metavar="FILE", help="evaluator instead of a model: finest.tar")
    parser.add_argument("--words", type=Path, metavar="FILE", help="its words, one a line in the order of the vectors")
    parser.add_argument("--word-vectors", type=Path, metavar="FILE", help="its table of them, our_vab_data.npy")
    parser.add_argument("--num-heads", type=int, default=16, help="attention heads of the GPT (default: %(default)s)")
    parser.add_argument("--dilation-growth", type=int, default=3, help="of the VQ-VAE (default: %(default)s)")
    parser.add_argument("--activation", choices=["relu", "silu", "gelu"], default="relu", help="(default: relu)")
    parser.add_argument("--norm", choices=["LN", "GN"], help="of the VQ-VAE, where it has one of the two (default: LN)")
    parser.add_argument(
        "--quantizer", choices=["ema", "reset", "ema_reset"], help="how the codebook learnt (default: ema_reset)"
    )
    parser.add_argument(
        "--clip", metavar="NAME_OR_FOLDER", help="the text encoder; a folder is copied in (default: ViT-B/32 by name)"
    )
    parser.add_argument("--card", type=Path, metavar="FILE", help="model card (Markdown) instead of the plain one")
    parser.add_argument(
        "--export-official", metavar="MODEL", help="the other way: bundle, run or bundled name to write"
    )


def run(args: argparse.Namespace) -> None:
    """Writes the folder and prints its name."""
    from t2m_jax.errors import UserError

    given = [name for name in dict.fromkeys((*_FILES, *_EVALUATOR_FILES)) if getattr(args, name) is not None]
    if args.export_official is not None:
        if given:
            raise UserError(f"convert: --{_option(given[0])} and --export-official exclude each other")
        _export(args)
    else:
        kind, wanted = ("a model", _FILES) if args.evaluator is None else ("an evaluator", _EVALUATOR_FILES)
        strangers = [f"--{_option(name)}" for name in given if name not in wanted]
        if strangers:
            raise UserError(f"convert: {', '.join(strangers)} is no part of {kind}")
        missing = [f"--{_option(name)}" for name in wanted if name not in given]
        if missing:
            number = {4: "four", 5: "five"}[len(wanted)]
            raise UserError(f"convert: {', '.join(missing)} missing; {kind} is made of all {number} files")
        (_convert if args.evaluator is None else _convert_evaluator)(args)
    sys.stdout.write(f"{args.destination}\n")


def _option(name: str) -> str:
    return name.replace("_", "-")


def _export(args: argparse.Namespace) -> None:
    from t2m_jax.checkpoints.gpt_run import load_model
    from t2m_jax.checkpoints.official.export import export_official

    export_official(args.destination, load_model(args.export_official))


def _convert(args: argparse.Namespace) -> None:
    from t2m_jax.checkpoints.bundle import save_bundle
    from t2m_jax.checkpoints.official.bundle import OfficialFiles, OfficialOptions, load_official, official_card

    files = OfficialFiles(*(getattr(args, name) for name in _FILES))
    names = [field.name for field in dataclasses.fields(OfficialOptions)]
    bundle = load_official(files, options=OfficialOptions(**{name: getattr(args, name) for name in names}))
    bundle, clip = _with_clip(bundle, args.clip)
    card = args.card.read_text(encoding="utf-8") if args.card else official_card(files, bundle)
    save_bundle(args.destination, bundle, card=card, half=False, clip=clip)


def _convert_evaluator(args: argparse.Namespace) -> None:
    from t2m_jax.checkpoints.evaluator import save_evaluator
    from t2m_jax.checkpoints.official.bundle import OfficialEvaluatorFiles, load_official_evaluator

    files = OfficialEvaluatorFiles(*(getattr(args, name) for name in _EVALUATOR_FILES))
    save_evaluator(args.destination, load_official_evaluator(files))


def _with_clip(bundle: "Bundle", name_or_folder: str | None) -> "tuple[Bundle, TrainedClip | None]":
    """Returns the model with its text encoder named, and that itself where it is to be copied."""
    from t2m_jax.checkpoints.clip import load_clip

    if name_or_folder is None:
        return bundle, None
    if not Path(name_or_folder).is_dir():
        return bundle._replace(config=dataclasses.replace(bundle.config, clip=name_or_folder)), None
    return bundle, load_clip(name_or_folder, text_dim=bundle.config.gpt.text_dim)
