"""Train a model: `t2m train {vqvae,gpt} CONFIG [--field value]...`; fields are those of the config, dotted."""

import argparse
import logging
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

    return {"vqvae": TrainVqVaeConfig, "gpt": TrainGptConfig}[stage]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command; what it does not know are fields of the config."""
    parser.add_argument("stage", choices=("vqvae", "gpt"), help="what to train")
    parser.add_argument("config", help="YAML file with what differs from the defaults")
    parser.add_argument("--resume", action="store_true", help="go on from the run's newest checkpoint")
    parser.add_argument("-h", "--help", nargs=0, action=_Help, help="show this (after a stage: all fields) and exit")


def run(args: argparse.Namespace) -> None:
    """Trains; the run directory is the result."""
    from t2m_jax.config import load_config, override_config

    config: Any = load_config(args.config, _schema(args.stage))
    config = override_config(config, args.config_options, prog=f"t2m train {args.stage}")

    from t2m_jax.sampling.compilation import use_compilation_cache
    from t2m_jax.train.run_gpt import train_gpt
    from t2m_jax.train.run_vqvae import train_vqvae

    use_compilation_cache()
    if args.stage == "vqvae":
        train_vqvae(config, resume=args.resume)
    else:
        train_gpt(config, resume=args.resume)
    logging.getLogger("t2m_jax").info("done: %s", config.run)
