"""Train a model: `t2m train KIND CONFIG [--field value]...`; fields are those of the config, with dots.

CONFIG is a YAML file, or the name of a config or preset that comes with the package: `t2m train --list` shows them.
Such a name wins over a file or folder with that name: `official` is the preset, and `./official` the file.
`t2m train KIND --run RUN --resume` continues a run.
`t2m train gpt --diff paper official` shows how two configs differ.
"""

import argparse
import contextlib
import importlib.metadata
import os
import shlex
import sys
from pathlib import Path
from typing import Any

from t2m_jax.cli.allocation import keep_freed_memory
from t2m_jax.cli.options import print_columns, show_next
from t2m_jax.errors import UserError

TAKES_CONFIG_OPTIONS = True


class _Help(argparse.Action):
    """Shows the command's help and, if the kind is known, every field of its config."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: Any, values: Any, option_string: Any = None) -> None:
        parser.print_help()
        if namespace.kind:
            from t2m_jax.config import override_config
            from t2m_jax.train.experiment import find_trainer

            default = find_trainer(namespace.kind).config()
            override_config(default, ["--help"], prog=f"t2m train {namespace.kind} CONFIG")
        parser.exit()


class _List(argparse.Action):
    """Shows the configs and presets that come with the package."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: Any, values: Any, option_string: Any = None) -> None:
        from t2m_jax.train.shipped import preset_names, shipped_configs

        configs = shipped_configs()
        rows = [(config.kind, name, config.summary) for name, config in configs.items()]
        for kind in dict.fromkeys(config.kind for config in configs.values()):
            rows += [(kind, name, "preset") for name in preset_names(kind)]
        print_columns(sorted(rows))
        parser.exit()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options of the command; unknown options are fields of the config."""
    kinds = sorted(importlib.metadata.entry_points(group="t2m_jax.trainers").names)
    parser.add_argument("kind", choices=kinds, help="what to train")
    parser.add_argument("config", nargs="?", help="YAML file with what differs from the defaults, or a name of --list")
    parser.add_argument("--list", nargs=0, action=_List, help="show the configs and presets of the package and exit")
    parser.add_argument("--resume", action="store_true", help="continue from the newest checkpoint of the run")
    parser.add_argument(
        "--diff",
        nargs=2,
        metavar=("A", "B"),
        help="show the fields in which two configs or recipes differ; nothing is trained",
    )
    several = parser.add_argument_group("several processes", "start the same command once per process")
    several.add_argument("--distributed", action="store_true", help="take the next three from the cluster's variables")
    several.add_argument("--coordinator", metavar="HOST:PORT", help="address of process 0")
    several.add_argument("--num-processes", type=int, metavar="N", help="how many processes train together")
    several.add_argument("--process-id", type=int, metavar="I", help="number of this process, from 0")
    several.add_argument("--heartbeat", type=int, metavar="SECONDS", help="silence that ends the others (default 30)")
    parser.add_argument("-h", "--help", nargs=0, action=_Help, help="show this (after a kind: all fields) and exit")


def run(args: argparse.Namespace) -> None:
    """Trains and prints the next command; the run directory is the result."""
    if args.diff:
        _show_differences(args)
        return
    keep_freed_memory()
    from t2m_jax.config import override_config
    from t2m_jax.distributed import is_writer
    from t2m_jax.sampling.compilation import use_compilation_cache
    from t2m_jax.train.experiment import find_trainer, train

    config: Any = override_config(_start_config(args), args.config_options, prog=f"t2m train {args.kind}")
    use_compilation_cache()
    with _several_processes(args):
        train(config, resume=args.resume)
        if is_writer():
            sys.stdout.write(f"{config.run}\n")
            places = {name: shlex.quote(str(getattr(config, name))) for name in ("run", "data")}
            show_next(find_trainer(args.kind).next_command.format(**places))


def _several_processes(args: argparse.Namespace) -> contextlib.AbstractContextManager[None]:
    """Returns the context in which the processes of a run train together; with one process it does nothing."""
    given = (args.coordinator, args.num_processes, args.process_id)
    if not args.distributed and given == (None, None, None) and args.heartbeat is None:
        return contextlib.nullcontext()
    from t2m_jax.distributed import HEARTBEAT, Processes, connected, find_processes

    if args.distributed == (given != (None, None, None)):
        raise UserError("train: give either --distributed, or --coordinator with --num-processes and --process-id")
    heartbeat = HEARTBEAT if args.heartbeat is None else args.heartbeat
    if heartbeat < 5:
        raise UserError("train: --heartbeat must be at least 5")
    if args.distributed:
        return connected(find_processes(os.environ, heartbeat=heartbeat))
    if (
        None in given
        or not 0 <= args.process_id < args.num_processes
        or not args.coordinator.rpartition(":")[2].isdigit()
    ):
        raise UserError("train: --coordinator HOST:PORT needs --num-processes N and --process-id I with 0 <= I < N")
    return connected(Processes(*given, heartbeat=heartbeat))


def _start_config(args: argparse.Namespace) -> Any:
    """Returns the config that the options change: of CONFIG or, to resume without one, of the run."""
    from t2m_jax.train.experiment import load_run_config

    if args.config is not None:
        return _config(args.kind, args.config)
    # Of the other options nothing is known before the config, and that is in the folder of the run.
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--run", type=Path, nargs="?")
    found = parser.parse_known_args(args.config_options)[0].run
    if not args.resume or found is None:
        raise UserError(
            f"train {args.kind}: CONFIG is missing; give a YAML file, give a name that `t2m train --list` shows, or "
            "continue a run with `--run RUN --resume`"
        )
    config = load_run_config(found)
    if config.kind != args.kind:
        raise UserError(f"{found}: is the run of a {config.kind}; resume it with `t2m train {config.kind}`")
    return config


def _config(kind: str, name: str) -> Any:
    """Returns the config of a name that `--list` shows, or of a file."""
    from t2m_jax.config import load_config
    from t2m_jax.train.experiment import find_trainer
    from t2m_jax.train.shipped import find_config, load_preset, preset_names, shipped_configs

    if name in preset_names():
        return load_preset(kind, name)
    is_file = Path(name).exists() and name not in shipped_configs()
    schema: Any = find_trainer(kind).config
    return load_config(name if is_file else find_config(kind, name), schema)


def _show_differences(args: argparse.Namespace) -> None:
    """Prints a table of the fields in which two configs differ."""
    from t2m_jax.train.shipped import differences

    if args.config_options:
        raise UserError(f"train {args.kind}: --diff compares configs as they are; remove {args.config_options[0]}")
    rows = [("field", *args.diff)]
    for field, values in differences(*(_config(args.kind, name) for name in args.diff)).items():
        rows.append((field, *map(str, values)))
    print_columns(rows)
