"""Pack run folders into one model to share: `t2m bundle RUN... DIR`."""

import argparse
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from t2m_jax.cli.next_step import show_next
from t2m_jax.errors import UserError

if TYPE_CHECKING:
    from t2m_jax.checkpoints.bundle import Bundle
    from t2m_jax.checkpoints.clip import TrainedClip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    parser.add_argument("runs", nargs="+", help="run folder of a generator, which contains its tokenizer")
    parser.add_argument("destination", help="folder to write")
    parser.add_argument("--card", default=None, metavar="FILE", help="model card (Markdown) to include")
    parser.add_argument("--export-official", action="store_true", help="also write files for the original code")


def run(args: argparse.Namespace) -> None:
    """Writes the bundle, and prints its name and the next command."""
    from t2m_jax.checkpoints.bundle import ClipReference, default_card
    from t2m_jax.checkpoints.clip import load_clip
    from t2m_jax.checkpoints.model import load_runs
    from t2m_jax.checkpoints.official import official_state_dicts
    from t2m_jax.files import check_new, load_text

    destination = Path(args.destination)
    check_new(destination)
    run_folder, bundle = load_runs([Path(path) for path in args.runs])
    if args.export_official:
        official_state_dicts(bundle)  # so that a model without that form is refused before anything is written
    card = load_text(Path(args.card)) if args.card else default_card(run_folder)
    text_encoder = bundle.config.text_encoder
    clip = load_clip(text_encoder.name) if isinstance(text_encoder, ClipReference) else None
    _write(destination, bundle, card=card, clip=clip, official=args.export_official)
    sys.stdout.write(f"{args.destination}\n")
    show_next(f't2m generate "a person walks forward" --model {shlex.quote(args.destination)}')


def _write(destination: Path, bundle: "Bundle", *, card: str, clip: "TrainedClip | None", official: bool) -> None:
    """Writes the bundle and, if `official`, the files for the original code: all or nothing."""
    from t2m_jax.checkpoints.bundle import save_bundle
    from t2m_jax.checkpoints.official import export_official
    from t2m_jax.files import atomic_folder

    with atomic_folder(destination) as folder:
        finished = folder / "bundle"  # a folder of its own, because a bundle is written into a new folder
        try:
            save_bundle(finished, bundle, card=card, clip=clip)
            if official:
                export_official(finished / "official", bundle)
        except UserError as error:
            if isinstance(error.__cause__, OSError):  # a full disk; the outer folder says so with the final name
                raise error.__cause__ from None
            raise
        for path in list(finished.iterdir()):
            path.rename(folder / path.name)
        finished.rmdir()
