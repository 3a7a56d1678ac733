"""Pack run folders into one model to share: `t2m bundle RUN... DIR`."""

import argparse
import shlex
import sys
from pathlib import Path

from t2m_jax.cli.next_step import show_next


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    parser.add_argument("runs", nargs="+", help="run folder of a generator, which contains its tokenizer")
    parser.add_argument("destination", help="folder to write")
    parser.add_argument("--card", default=None, metavar="FILE", help="model card (Markdown) to include")
    parser.add_argument("--export-official", action="store_true", help="also write files for the original code")


def run(args: argparse.Namespace) -> None:
    """Writes the bundle, and prints its name and the next command."""
    from t2m_jax.checkpoints.bundle import ClipReference, default_card, write_bundle
    from t2m_jax.checkpoints.clip import load_clip
    from t2m_jax.checkpoints.model import load_runs
    from t2m_jax.checkpoints.official import export_official
    from t2m_jax.files import atomic_folder, load_text

    with atomic_folder(Path(args.destination)) as folder:
        run_folder, bundle = load_runs([Path(path) for path in args.runs])
        card = load_text(Path(args.card)) if args.card else default_card(run_folder)
        text_encoder = bundle.config.text_encoder
        clip = load_clip(text_encoder.name) if isinstance(text_encoder, ClipReference) else None
        write_bundle(folder, bundle, card=card, clip=clip)
        if args.export_official:
            export_official(folder / "official", bundle)
    sys.stdout.write(f"{args.destination}\n")
    show_next(f't2m generate "a person walks forward" --model {shlex.quote(args.destination)}')
