"""Convert published weights into a model, and models into the published form.

A model from the files of T2M-GPT:
  t2m convert official --vqvae FILE --gpt FILE --mean FILE --std FILE DIR
An evaluator from the files of text-to-motion:
  t2m convert official --evaluator FILE --mean FILE --std FILE --words FILE --word-vectors FILE DIR
Any T2M-GPT of ours as files for the original code:
  t2m convert official --export-official MODEL DIR
A small copy of a sentence encoder, with English words and 8 bits for each weight:
  t2m convert sentence --encoder NAME_OR_FOLDER DIR
"""

import argparse
import dataclasses
import shlex
import sys
from pathlib import Path

from t2m_jax.cli.options import option_of, show_next
from t2m_jax.errors import UserError

_MODEL_FILES = ("vqvae", "gpt", "mean", "std")
_MODEL_OPTIONS = ("num_heads", "dilation_growth", "activation", "norm", "quantizer", "ema_decay", "reset_threshold")
_EVALUATOR_FILES = ("evaluator", "mean", "std", "words", "word_vectors")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command."""
    kinds = "what is converted: files of the original PyTorch code, or a sentence encoder"
    parser.add_argument("source", choices=["official", "sentence"], help=kinds)
    parser.add_argument("destination", type=Path, metavar="DIR", help="folder to write")
    files = {
        "vqvae": "VQ-VAE (.pth, .tar or .safetensors)",
        "gpt": "GPT (.pth, .tar or .safetensors)",
        "mean": "mean.npy that was published with them",
        "std": "std.npy that was published with them",
        "evaluator": "evaluator (finest.tar)",
        "words": "words of the evaluator, one per line in the order of the vectors",
        "word_vectors": "word vectors of the evaluator (our_vab_data.npy)",
    }
    for name, help_ in files.items():
        parser.add_argument(option_of(name), type=Path, metavar="FILE", help=help_)
    parser.add_argument("--encoder", metavar="NAME_OR_FOLDER", help="sentence encoder of which to make a small copy")
    parser.add_argument("--num-heads", type=int, help="attention heads of the GPT (default: 16)")
    vqvae = parser.add_argument_group("options of the VQ-VAE that its file does not contain")
    vqvae.add_argument("--dilation-growth", type=int, help="ratio of dilations (default: 3)")
    vqvae.add_argument("--activation", choices=["relu", "silu", "gelu"], help="default: relu")
    vqvae.add_argument("--norm", choices=["LN", "GN"], help="if it has one of the two (default: LN)")
    vqvae.add_argument("--quantizer", choices=["ema", "reset", "ema_reset"], help="codebook rule (default: ema_reset)")
    vqvae.add_argument("--ema-decay", type=float, help="in further training (default: 0.99)")
    vqvae.add_argument("--reset-threshold", type=float, help="in further training (default: 1.0)")
    parser.add_argument(
        "--clip", metavar="NAME_OR_FOLDER", help="text encoder; a folder is copied (default: ViT-B/32 by its hub name)"
    )
    parser.add_argument("--card", type=Path, metavar="FILE", help="model card (Markdown) to use instead of a plain one")
    parser.add_argument(
        "--export-official", metavar="MODEL", help="model to write as such files (as `t2m generate --model`)"
    )


def run(args: argparse.Namespace) -> None:
    """Writes the folder, and prints its name and the next command."""
    from t2m_jax.checkpoints.evaluator import save_evaluator
    from t2m_jax.checkpoints.model import load_model
    from t2m_jax.checkpoints.official import export_official
    from t2m_jax.checkpoints.official.bundle import OfficialEvaluatorFiles, load_official_evaluator

    folder = shlex.quote(f"{args.destination}")
    if args.source == "sentence" or args.encoder is not None:
        _convert_sentence_encoder(args)
        following = f"t2m train gpt CONFIG --text_encoder sentence_states --sentence {folder}"
    elif args.export_official is not None:
        _check_files(args, "--export-official", ())
        export_official(args.destination, load_model(args.export_official))
        following = f"load the files of {folder} with the original code"
    elif args.evaluator is not None:
        files = OfficialEvaluatorFiles(*_check_files(args, "an evaluator", _EVALUATOR_FILES))
        save_evaluator(args.destination, load_official_evaluator(files))
        following = f"t2m evaluate generation --data DATA --evaluator {folder}"
    else:
        _convert_model(args, _check_files(args, "a model", _MODEL_FILES, (*_MODEL_OPTIONS, "clip", "card")))
        following = f't2m generate "a man walks in a circle" --model {folder}'
    sys.stdout.write(f"{args.destination}\n")
    show_next(following)


def _check_files(
    args: argparse.Namespace, task: str, wanted: tuple[str, ...], options: tuple[str, ...] = ()
) -> list[Path]:
    """Returns the files of a task. Raises `UserError` if some are missing, or an option is given that is not read."""
    known = dict.fromkeys((*_MODEL_FILES, *_EVALUATOR_FILES, *_MODEL_OPTIONS, "clip", "card"))
    given = [name for name in known if getattr(args, name) is not None]
    # What is too much is probably a mistake: nobody gives it to see it ignored.
    extra = [option_of(name) for name in given if name not in (*wanted, *options)]
    missing = [option_of(name) for name in wanted if name not in given]
    if extra:
        raise UserError(f"convert: {', '.join(extra)} cannot be used with {task}; leave it out")
    if missing:
        raise UserError(f"convert: {', '.join(missing)} missing; {task} needs {', '.join(map(option_of, wanted))}")
    return [getattr(args, name) for name in wanted]


def _convert_model(args: argparse.Namespace, paths: list[Path]) -> None:
    from t2m_jax.checkpoints.bundle import save_bundle
    from t2m_jax.checkpoints.official.bundle import OfficialFiles, load_official, official_card
    from t2m_jax.checkpoints.text_encoder import ClipReference, load_pretrained
    from t2m_jax.files.reading import load_text
    from t2m_jax.files.writing import check_new

    # Before the weights are read, which takes longest.
    check_new(args.destination)
    files = OfficialFiles(*paths)
    given = {name: getattr(args, name) for name in _MODEL_OPTIONS}
    bundle = load_official(files, **{name: value for name, value in given.items() if value is not None})
    clip = None
    # A folder is copied into the model. A name is only noted, and found again when the model is loaded.
    if args.clip is not None and Path(args.clip).is_dir():
        clip = load_pretrained(ClipReference(name=args.clip), text_dim=bundle.config.generator.text_dim)
    elif args.clip is not None:
        config = dataclasses.replace(bundle.config, text_encoder=ClipReference(name=args.clip))
        bundle = bundle._replace(config=config)
    card = official_card(files, bundle) if args.card is None else load_text(args.card)
    # Weights keep 32 bits, so that results are those of the original files.
    save_bundle(args.destination, bundle, card=card, half=False, encoder=clip)


def _convert_sentence_encoder(args: argparse.Namespace) -> None:
    from t2m_jax.checkpoints.compact import save_compact_encoder
    from t2m_jax.checkpoints.encoder_files import find_encoder
    from t2m_jax.checkpoints.sentence import SENTENCE_FILES

    _check_files(args, "a sentence encoder", ())
    if args.source != "sentence" or args.encoder is None:
        raise UserError("convert: give both, `t2m convert sentence --encoder NAME_OR_FOLDER DIR`")
    save_compact_encoder(args.destination, find_encoder(args.encoder, SENTENCE_FILES))
