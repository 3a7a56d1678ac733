"""Pack run folders into one model to share: `t2m bundle RUN... DIR`."""

import argparse
import sys
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    parser.add_argument("runs", nargs="+", help="run folder of a GPT; it holds its VQ-VAE already")
    parser.add_argument("destination", help="folder to write")
    parser.add_argument("--card", default=None, metavar="FILE", help="model card (Markdown) to put in")
    parser.add_argument(
        "--export-official", action="store_true", help="also write the weights as the original PyTorch code names them"
    )


def run(args: argparse.Namespace) -> None:
    """Writes the bundle."""
    from t2m_jax.checkpoints.bundle import save_bundle
    from t2m_jax.checkpoints.card import plain_card
    from t2m_jax.checkpoints.clip import load_clip
    from t2m_jax.checkpoints.gpt_run import load_gpt_runs
    from t2m_jax.checkpoints.official.export import export_official

    run_folder, bundle = load_gpt_runs([Path(path) for path in args.runs])
    card = Path(args.card).read_text(encoding="utf-8") if args.card else plain_card(run_folder)
    clip = load_clip(bundle.config.clip) if bundle.config.text_encoder == "clip" else None
    save_bundle(Path(args.destination), bundle, card=card, clip=clip)
    if args.export_official:
        export_official(Path(args.destination) / "official", bundle)
    sys.stdout.write(f"{args.destination}\n")
