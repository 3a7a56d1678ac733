"""List the packaged models, or show the card of a model: `t2m models`, `t2m models demo`."""

import argparse
import sys

from t2m_jax.cli.next_step import show_next


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    parser.add_argument("model", nargs="?", help="show the card of this model: a bundled name or a bundle folder")


def run(args: argparse.Namespace) -> None:
    """Prints a line for each model, or the card of one, and the next command."""
    from t2m_jax.checkpoints.bundle import BUNDLED, card_license, load_card

    if args.model is not None:
        sys.stdout.write(load_card(args.model))
        return
    for name in BUNDLED:
        card = load_card(name)
        title = next(line.removeprefix("# ") for line in card.splitlines() if line.startswith("# "))
        sys.stdout.write(f"{title} ({card_license(card)})\n")
    show_next(f"t2m models {BUNDLED[0]}")
