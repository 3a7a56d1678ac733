"""A complete model from a bundled name, a bundle folder, the run of a generator, or the Hugging Face hub."""

from collections.abc import Sequence
from pathlib import Path

import jax

from t2m_jax.checkpoints.best import restore_trained
from t2m_jax.checkpoints.bundle import (
    CONFIG_FILE,
    Bundle,
    expected_variables,
    load_bundle,
    load_bundle_config,
    load_text_tokenizer,
    load_training_data,
    part_kinds,
)
from t2m_jax.checkpoints.hub_models import find_model
from t2m_jax.checkpoints.run import is_run, run_info
from t2m_jax.checkpoints.tokenizer import TrainedTokenizer, load_tokenizer
from t2m_jax.errors import UserError


def load_model(name_or_path: str | Path) -> Bundle:
    """Returns a model by a bundled name, a bundle folder, a generator's run, or a name on the hub (see `find_model`).

    Raises:
        UserError: There is none, or it is damaged.
    """
    path, source = find_model(name_or_path)
    bundle = load_generator_run(path) if is_run(path) else load_bundle(path)
    return bundle._replace(source=source)


def load_generator_run(path: Path) -> Bundle:
    """Returns the model of a generator's run, with its best weights if any were chosen, else with its newest.

    Raises:
        UserError: The folder is not such a run, or has no checkpoint.
    """
    kind = run_info(path).kind
    if not (path / CONFIG_FILE).is_file():
        raise UserError(f"{path}: is the run of a {kind} only; generation needs the run of a generator, such as a GPT")
    tokenizer = load_tokenizer(path)
    config = load_bundle_config(path)
    kinds = {role: kind for role, kind in part_kinds(config).items() if role != "tokenizer"}
    expected = expected_variables(config)
    # A training state has one field per collection, and in it one entry per kind of part.
    collections = {name for role in kinds for name in expected[role]}
    fields = {
        name: {kind: expected[role][name] for role, kind in kinds.items() if name in expected[role]}
        for name in collections
    }
    # Only these fields: the moments of the optimizer have twice the size of the weights.
    found = jax.device_get(restore_trained(path, fields))
    variables = {"tokenizer": tokenizer.variables} | {
        role: {name: found[name][kind] for name in expected[role]} for role, kind in kinds.items()
    }
    text_tokenizer = load_text_tokenizer(path, config)
    return Bundle(config, variables, tokenizer.normalizer, text_tokenizer, load_training_data(path))


def load_runs(paths: Sequence[Path]) -> tuple[Path, Bundle]:
    """Returns the one generator's run among some run directories, and its model.

    The generator's run contains a copy of its tokenizer. The run of a tokenizer may be given, too, whose decoder was
    trained further (`trained: decoder`): the model then has this decoder.

    Raises:
        UserError: There is not exactly one generator's run, or a tokenizer is not the one that it was trained with.
    """
    generators = [path for path in paths if run_info(path) and (path / CONFIG_FILE).is_file()]
    if len(generators) != 1:
        raise UserError(f"{len(generators)} of {len(paths)} folders are runs of a generator; a bundle needs one")
    bundle = load_generator_run(generators[0])
    for path in paths:
        if path == generators[0]:
            continue
        tokenizer = load_tokenizer(path)
        own = TrainedTokenizer(bundle.config.tokenizer, bundle.variables["tokenizer"], bundle.normalizer)
        # The copy was made when the generator's training began. A tokenizer that was trained further since has other
        # codes.
        if not tokenizer.has_codes_of(own):
            raise UserError(f"{path}: is not the tokenizer that {generators[0]} was trained with")
        bundle = bundle._replace(variables=bundle.variables | {"tokenizer": jax.device_get(tokenizer.variables)})
    return generators[0], bundle
