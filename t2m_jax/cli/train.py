"""Train a model: `t2m train {vqvae,gpt,evaluator} CONFIG [--field value]...`; fields are those of the config, dotted.

CONFIG is a YAML file or, of vqvae and gpt, a recipe of T2M-GPT by name: `official` or `paper`, for KIT-ML
`kit_ml/official` and so on.
`t2m train gpt --diff paper official` shows in what two of them differ.
"""

import argparse
import logging
import sys
from typing import Any

TAKES_CONFIG_OPTIONS = True


class _Help(argparse.Action):
    """Shows the command's help and, once the stage is known, every field of its config."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: Any, values: Any, option_string: Any = None) -> None:
        parser.print_help()
        if namespace.stage:
            from t2m_jax.config import override_config

            override_config(_schema(namespace.stage)(), ["--help"], prog=f"t2m train {namespace.stage} CONFIG")
        parser.exit()


def _schema(stage: str) -> type:
    from t2m_jax.train.config import TrainGptConfig, TrainVqVaeConfig
    from t2m_jax.train.evaluator_config import TrainEvaluatorConfig

    return {"vqvae": TrainVqVaeConfig, "gpt": TrainGptConfig, "evaluator": TrainEvaluatorConfig}[stage]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command; what it does not know are fields of the config."""
    parser.add_argument("stage", choices=("vqvae", "gpt", "evaluator"), help="what to train")
    parser.add_argument("config", nargs="?", help="YAML file with what differs from the defaults, or name of a recipe")
    parser.add_argument("--resume", action="store_true", help="go on from the run's newest checkpoint")
    parser.add_argument(
        "--diff",
        nargs=2,
        metavar=("A", "B"),
        help="show in what two configs or recipes differ; CONFIG is left out, nothing is trained",
    )
    parser.add_argument("-h", "--help", nargs=0, action=_Help, help="show this (after a stage: all fields) and exit")


def run(args: argparse.Namespace) -> None:
    """Trains; the run directory is the result."""
    if args.diff:
        _show_differences(args)
        return
    from t2m_jax.config import override_config
    from t2m_jax.errors import UserError

    if args.config is None:
        raise UserError(f"train {args.stage}: give a CONFIG, a YAML file or the name of a recipe such as 'official'")
    config: Any = _config(args.stage, args.config)
    config = override_config(config, args.config_options, prog=f"t2m train {args.stage}")

    from t2m_jax.sampling.compilation import use_compilation_cache
    from t2m_jax.train.run_evaluator import train_evaluator
    from t2m_jax.train.run_gpt import train_gpt
    from t2m_jax.train.run_vqvae import train_vqvae

    use_compilation_cache()
    if args.stage == "vqvae":
        train_vqvae(config, resume=args.resume)
    elif args.stage == "gpt":
        train_gpt(config, resume=args.resume)
    else:
        train_evaluator(config, resume=args.resume)
    logging.getLogger("t2m_jax").info("done: %s", config.run)


def _config(stage: str, name: str) -> Any:
    """Returns the config of a file or, where there is no such file, of a recipe."""
    from pathlib import Path

    from t2m_jax.config import load_config
    from t2m_jax.train.presets import load_preset, preset_names

    if name in preset_names() and not Path(name).exists():
        return load_preset(stage, name)
    return load_config(name, _schema(stage))


def _show_differences(args: argparse.Namespace) -> None:
    """Prints a table of the fields in which two configs differ."""
    from t2m_jax.errors import UserError
    from t2m_jax.train.presets import differences

    if args.config_options:
        raise UserError(f"train {args.stage}: --diff compares configs as they are; leave {args.config_options[0]} out")
    rows = [("field", *args.diff)]
    for field, values in differences(*(_config(args.stage, name) for name in args.diff)).items():
        rows.append((field, *map(str, values)))
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    for row in rows:
        sys.stdout.write("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() + "\n")
