"""A trained tokenizer: from its run, from a bundle, or from the copy in a generator's run."""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from flax import traverse_util

from t2m_jax.checkpoints.best import restore_trained
from t2m_jax.checkpoints.bundle import CONFIG_FILE, bundle_path, check_statistics_width, load_bundle, load_bundle_config
from t2m_jax.checkpoints.hub_models import find_model
from t2m_jax.checkpoints.run import is_run, run_info
from t2m_jax.config import load_config, save_config
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import fingerprint, load_arrays, save_arrays
from t2m_jax.files.manifest import check_folder, write_manifest
from t2m_jax.models.system import TokenizerConfig, find_part, make_module, variable_shapes
from t2m_jax.models.vqvae import DECODER_PARTS
from t2m_jax.motion.normalizer import Normalizer, load_normalizer, save_normalizer

SAME_WEIGHTS = 2e-3
"""Relative and absolute tolerance for the weights of one tokenizer: bundles store them in 16 bits."""
DECODER_WEIGHTS = tuple(f"codes/params/{part}/" for part in DECODER_PARTS)
"""How the names of weights begin that do not change the codes of motion."""


class TrainedTokenizer(NamedTuple):
    """A tokenizer and the statistics of the motion that it reads."""

    config: TokenizerConfig
    variables: dict[str, Any]
    normalizer: Normalizer

    @property
    def module(self) -> Any:
        """The Linen module; hashable, so that it can be a static argument of jitted functions."""
        return make_module(self.config)

    @property
    def fingerprint(self) -> str:
        """Identifies the tokenizer: a digest of sizes, weights and statistics."""
        return fingerprint(repr(self.config), jax.device_get(self.variables), self.normalizer._asdict())

    def has_codes_of(self, other: "TrainedTokenizer") -> bool:
        """Returns whether code k means the same motion as with another tokenizer; only decoders may differ."""
        parts = (
            {"codes": tokenizer.variables, "statistics": tokenizer.normalizer._asdict()} for tokenizer in (self, other)
        )
        own, given = (traverse_util.flatten_dict(part, sep="/") for part in parts)
        return self.config == other.config and all(
            np.allclose(own[name], given[name], rtol=SAME_WEIGHTS, atol=SAME_WEIGHTS)
            for name in given
            if not name.startswith(DECODER_WEIGHTS)
        )


def load_tokenizer_config(path: str | Path) -> TokenizerConfig:
    """Returns the sizes of the tokenizer of a bundle or a run.

    Raises:
        UserError: There is no tokenizer, or its config is damaged.
    """
    path = bundle_path(path)
    if is_run(path):
        check_folder(path)  # the statistics and sizes that the run was started with
    if (path / CONFIG_FILE).is_file():
        return load_bundle_config(path).tokenizer
    if not is_run(path):
        raise UserError(f"{path}: neither a run nor a bundle; train a tokenizer with `t2m train vqvae` first")
    kind = run_info(path).kind
    return load_config(tokenizer_config_file(path, kind), find_part(kind, "tokenizer").config)


def load_tokenizer(path: str | Path) -> TrainedTokenizer:
    """Returns the tokenizer of a bundle, of its own run, of a generator's run, or of a model on the hub.

    The tokenizer of its own run has the best weights if any were chosen, else the newest.

    Raises:
        UserError: There is none, or it is damaged.
    """
    path = find_model(path).folder
    config = load_tokenizer_config(path)
    if not is_run(path):
        bundle = load_bundle(path)
        return TrainedTokenizer(config, bundle.variables["tokenizer"], bundle.normalizer)
    shapes = variable_shapes(config)
    if (path / CONFIG_FILE).is_file():
        path /= config.kind
        check_folder(path)
        variables = load_arrays(path / f"{config.kind}.safetensors", shapes)
    else:
        variables = restore_trained(path, shapes)
    normalizer = load_normalizer(path)
    check_statistics_width(path, normalizer, config.feature_dim)
    return TrainedTokenizer(config, variables, normalizer)


def tokenizer_config_file(folder: Path, kind: str) -> Path:
    """Returns the file with the sizes of a tokenizer in its run, or in its copy in a generator's run."""
    return folder / f"{kind}.yaml"


def save_tokenizer_parts(run: Path, config: TokenizerConfig, normalizer: Normalizer) -> None:
    """Writes what a tokenizer's run contains besides its weights: sizes and statistics."""
    run.mkdir(parents=True, exist_ok=True)
    save_config(tokenizer_config_file(run, config.kind), config)
    save_normalizer(run, normalizer)


def save_tokenizer_copy(run: Path, tokenizer: TrainedTokenizer) -> None:
    """Writes a tokenizer into a generator's run, so that the run needs no other folder."""
    kind = tokenizer.config.kind
    save_tokenizer_parts(run / kind, tokenizer.config, tokenizer.normalizer)
    save_arrays(run / kind / f"{kind}.safetensors", tokenizer.variables)
    write_manifest(run / kind)
