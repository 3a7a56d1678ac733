"""Writes our models as files that the original PyTorch code loads, so that its users can check us."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import traverse_util

from t2m_jax.checkpoints.bundle import Bundle
from t2m_jax.checkpoints.official import names
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import save_weights
from t2m_jax.files.writing import atomic_folder, check_new
from t2m_jax.models.motion_gpt import MotionGptConfig
from t2m_jax.models.vqvae import VqVaeConfig


def vqvae_state_dict(variables: Mapping[str, Any], config: VqVaeConfig) -> dict[str, np.ndarray]:
    """Returns the state dict that the original's VQ-VAE loads strictly; it does not contain the codebook's averages.

    Raises:
        UserError: It has several codes per row, or projections. The original has neither.
    """
    if config.num_quantizers != 1 or config.projections:
        raise UserError("tokenizer.num_quantizers, tokenizer.projections: the original code has no such VQ-VAE")
    return _state_dict(variables, names.vqvae_weights(config), names.vqvae_constant_shapes(config))


def gpt_state_dict(variables: Mapping[str, Any], config: MotionGptConfig) -> dict[str, np.ndarray]:
    """Returns the state dict that the original's GPT loads strictly.

    Raises:
        UserError: The number of blocks is odd. The original has as many in its base as in its head.
    """
    num_base, left_over = divmod(config.num_layers, 2)
    if left_over:
        raise UserError(f"generator.num_layers: {config.num_layers} is odd; the original has two halves of equal depth")
    weights = names.gpt_weights(config, num_base=num_base)
    return _state_dict(variables, weights, names.gpt_constant_shapes(config, num_base=num_base))


def _state_dict(
    variables: Mapping[str, Any], weights: Iterable[names.Weight], constants: Mapping[str, tuple[int, ...]]
) -> dict[str, np.ndarray]:
    """Returns the arrays by the original's names, and the arrays that the original saves although they are constant."""
    flat = traverse_util.flatten_dict(jax.device_get(dict(variables)))
    arrays = {}
    for weight in weights:
        array = np.asarray(flat[weight.path], np.float32)
        arrays[weight.key] = np.ascontiguousarray(array.T if weight.is_reversed else array)
    return arrays | {key: names.constant(key, shape) for key, shape in constants.items()}


def export_official(path: str | Path, bundle: Bundle) -> None:
    """Writes VQ-VAE, GPT and statistics into a new folder, with the original's names and order of axes.

    Raises:
        UserError: The folder exists already, or the original has no such model.
    """
    path = Path(path)
    # Before the work, so that a wrong path is reported at once.
    check_new(path)
    tokenizer = bundle.config.tokenizer
    generator = bundle.config.generator
    if not isinstance(tokenizer, VqVaeConfig) or not isinstance(generator, MotionGptConfig):
        kinds = f"{tokenizer.kind!r} and {generator.kind!r}"
        raise UserError(f"the original code has no model of {kinds}; only a T2M-GPT can be exported for it")
    state_dicts = {
        "vqvae": vqvae_state_dict(bundle.variables["tokenizer"], tokenizer),
        "gpt": gpt_state_dict(bundle.variables["generator"], generator),
    }
    with atomic_folder(path) as folder:
        for name, arrays in state_dicts.items():
            save_weights(folder / f"{name}.safetensors", arrays, metadata={"format": "pt"})
        for name, statistics in bundle.normalizer._asdict().items():
            np.save(folder / f"{name}.npy", np.asarray(statistics, np.float32))
