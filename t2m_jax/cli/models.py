"""List models, or show the card of one: `t2m models`, `t2m models demo`, `t2m models user/name`.

The list has the packaged models and those of the Hugging Face hub that are on this machine, with their licenses. A card
can also be shown before its model is downloaded.
"""

import argparse
import shlex
import sys

from t2m_jax.cli.options import show_next
from t2m_jax.errors import printable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    text = "show the card of this model: a bundled name, a bundle folder, or user/name or user/name@revision on the hub"
    parser.add_argument("model", nargs="?", help=text)


def run(args: argparse.Namespace) -> None:
    """Prints a line for each model, or the card of one, and the next command."""
    from t2m_jax.checkpoints.bundle import BUNDLED
    from t2m_jax.checkpoints.hub_models import cached_models, load_card

    if args.model is not None:
        sys.stdout.write("".join(f"{printable(line)}\n" for line in load_card(args.model).splitlines()))
        show_next(shlex.join(["t2m", "generate", "a person walks forward", "--model", args.model]))
        return
    for name in BUNDLED:
        sys.stdout.write(_line("", load_card(name)))
    # Only what is on this machine: a list of the hub would need the network.
    for model in cached_models():
        sys.stdout.write(_line(f"{model.source}: ", load_card(model.folder)))
    show_next(f"t2m models {BUNDLED[0]}")


def _line(name: str, card: str) -> str:
    """Returns the title and license of a card; those of packaged models begin with the name."""
    from t2m_jax.checkpoints.bundle import card_license

    title = next((line.removeprefix("# ") for line in card.splitlines() if line.startswith("# ")), "without title")
    return printable(f"{name}{title} ({card_license(card)})") + "\n"
