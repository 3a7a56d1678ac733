"""Teach a model other words for what it knows: `t2m teach MODEL SENTENCES DIR`. A CPU takes minutes.

SENTENCES is a YAML file with lists of new sentences by one that the model understands (docs/training.md):

    "a person waves with the left hand":
      - "a left-handed hello"
      - "say hi with your left"
"""

import argparse
import shlex
import sys
from pathlib import Path

from t2m_jax.cli.options import MODEL_HELP, add_seed_argument, positive, show_next


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    parser.add_argument("model", metavar="MODEL", help=MODEL_HELP)
    parser.add_argument("sentences", type=Path, metavar="SENTENCES", help="YAML file with new sentences")
    parser.add_argument("destination", type=Path, metavar="DIR", help="folder of the new model")
    kept = "data set of the model, whose captions keep their meaning; by default, some captions that the model has"
    parser.add_argument("--data", type=Path, metavar="DATA", help=kept)
    parser.add_argument("--num-steps", type=positive, default=1200, metavar="N", help="updates (default 1200)")
    add_seed_argument(parser)
    parser.add_argument("--card", type=Path, metavar="FILE", help="model card (Markdown), in place of the model's own")


def run(args: argparse.Namespace) -> None:
    """Writes the new model, and prints its name, what it understands and the next command."""
    from t2m_jax.checkpoints.bundle import default_card, save_bundle
    from t2m_jax.checkpoints.model import load_model
    from t2m_jax.checkpoints.run import is_run
    from t2m_jax.checkpoints.text_encoder import included_encoder
    from t2m_jax.data.folder import open_dataset
    from t2m_jax.errors import naming
    from t2m_jax.field_checks import check_seed
    from t2m_jax.files.reading import load_text
    from t2m_jax.files.writing import check_new
    from t2m_jax.sampling.pipeline import TextToMotion
    from t2m_jax.train.lessons import kept_captions, known_meanings, load_lessons
    from t2m_jax.train.teaching import teach, teachable_network

    check_new(args.destination)
    check_seed(args.seed)
    lessons, held_out = load_lessons(args.sentences)
    bundle = load_model(args.model)
    with naming(args.model):
        teachable_network(bundle)  # before an encoder such as CLIP is loaded
    own_card = default_card(Path(args.model)) if is_run(Path(args.model)) else bundle.card
    card = own_card if args.card is None else load_text(args.card)
    with naming(args.sentences):
        known = known_meanings([*lessons, *held_out], TextToMotion(bundle).knowledge)
    lessons = tuple(lesson for lesson in lessons if lesson.meaning in known)
    held_out = tuple(lesson for lesson in held_out if lesson.meaning in known)
    dataset = None if args.data is None else open_dataset(args.data)
    kept = kept_captions(dataset, bundle.training_data, seed=args.seed)
    with naming(args.model):
        taught = teach(bundle, lessons, kept, held_out=held_out, num_steps=args.num_steps, seed=args.seed)
    encoder = included_encoder(bundle.config.text_encoder)
    save_bundle(args.destination, taught.bundle, card=card, encoder=encoder)
    sys.stdout.write(f"{args.destination}\n")
    if held_out:
        sys.stdout.write(
            f"of {len(held_out)} sentences that were not taught, {taught.right_after} are nearest to their meaning "
            f"({taught.right_before} before)\n"
        )
    show_next(shlex.join(["t2m", "generate", lessons[0].sentence, "--model", str(args.destination)]))
