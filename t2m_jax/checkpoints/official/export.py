"""Models of ours as files that the original PyTorch code loads, so that its users can check us."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import traverse_util
from safetensors.numpy import save_file

from t2m_jax.checkpoints.bundle import Bundle
from t2m_jax.checkpoints.official.names import (
    Weight,
    constant,
    evaluator_weights,
    gpt_constant_shapes,
    gpt_weights,
    vqvae_constant_shapes,
    vqvae_weights,
)
from t2m_jax.errors import UserError
from t2m_jax.models.evaluator import EvaluatorConfig
from t2m_jax.models.motion_gpt import MotionGptConfig
from t2m_jax.models.vqvae import VqVaeConfig

VQVAE_FILE, GPT_FILE, MEAN_FILE, STD_FILE = "vqvae.safetensors", "gpt.safetensors", "mean.npy", "std.npy"


def vqvae_state_dict(variables: Mapping[str, Any], config: VqVaeConfig) -> dict[str, np.ndarray]:
    """Returns the state dict that the original's VQ-VAE loads strictly; the codebook's averages have no place in it."""
    return _state_dict(variables, vqvae_weights(config), vqvae_constant_shapes(config))


def gpt_state_dict(variables: Mapping[str, Any], config: MotionGptConfig) -> dict[str, np.ndarray]:
    """Returns the state dict that the original's GPT loads strictly.

    Raises:
        UserError: if the blocks cannot be shared out: the original has as many in its base as in its head.
    """
    num_base, left_over = divmod(config.num_layers, 2)
    if left_over:
        raise UserError(f"gpt.num_layers: {config.num_layers} is odd; the original has two halves of equal depth")
    weights = gpt_weights(config, num_base=num_base)
    return _state_dict(variables, weights, gpt_constant_shapes(config, num_base=num_base))


def evaluator_state_dict(variables: Mapping[str, Any], config: EvaluatorConfig) -> dict[str, np.ndarray]:
    """Returns the state dicts of the original's evaluator, the part's name before each key; word vectors left out."""
    return _state_dict(variables, evaluator_weights(config), {})


def _state_dict(
    variables: Mapping[str, Any], weights: Iterable[Weight], constants: Mapping[str, tuple[int, ...]]
) -> dict[str, np.ndarray]:
    flat = traverse_util.flatten_dict(jax.device_get(dict(variables)))
    arrays = {}
    for weight in weights:
        array = np.asarray(flat[weight.path], np.float32)
        arrays[weight.key] = np.ascontiguousarray(array.T if weight.is_reversed else array)
    return arrays | {key: constant(key, shape) for key, shape in constants.items()}


def export_official(folder: Path, bundle: Bundle) -> None:
    """Writes VQ-VAE, GPT and statistics in the key names and the orientation of the original.

    Raises:
        UserError: if the folder exists already, or the original has no such model.
    """
    if folder.exists():
        raise UserError(f"{folder}: exists already; choose another folder or remove it")
    vqvae = vqvae_state_dict(bundle.variables["vqvae"], bundle.config.vqvae)
    gpt = gpt_state_dict(bundle.variables["gpt"], bundle.config.gpt)
    folder.mkdir(parents=True)
    for name, arrays in ((VQVAE_FILE, vqvae), (GPT_FILE, gpt)):
        save_file(arrays, folder / name, metadata={"format": "pt"})
        (folder / name).chmod(0o644)  # safetensors makes them private
    np.save(folder / MEAN_FILE, np.asarray(bundle.normalizer.mean, np.float32))
    np.save(folder / STD_FILE, np.asarray(bundle.normalizer.std, np.float32))
