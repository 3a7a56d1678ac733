"""What pretrained text encoders share: parameters from arrays in PyTorch's layout, and a digest of an encoder."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import linen as nn
from flax import traverse_util
from tokenizers import Tokenizer

from t2m_jax.errors import UserError
from t2m_jax.files.arrays import fingerprint, fit_arrays
from t2m_jax.keys import new_key
from t2m_jax.text.bpe import largest_token

SCALE = ".scale"
"""Ends the name of the scales of a matrix that is stored in 8 bits."""


def restore_rows(path: Path, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns arrays in which each matrix of 8 bits is multiplied by its scales, as float32.

    A matrix [R, C] has scales [R, G], each for C / G numbers of a row.

    Raises:
        UserError: A matrix has no scales that fit.
    """
    restored = {name: array for name, array in arrays.items() if not name.endswith(SCALE)}
    for name, array in list(restored.items()):
        if array.dtype != np.int8:
            continue
        scales = arrays.get(name + SCALE, np.zeros(0))
        fits = array.ndim == scales.ndim == 2 and len(array) == len(scales) and scales.size
        if not fits or array.shape[1] % scales.shape[1]:
            raise UserError(f"{path}: array {name[:80]!r} has 8 bits, but no scales that fit its rows")
        parts = array.reshape(*scales.shape, -1) * scales[:, :, None].astype(np.float32)
        restored[name] = parts.reshape(array.shape)
    return restored


def quantized_rows(arrays: Mapping[str, np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Returns the matrices of 8 bits [R, C] among arrays that `restore_rows` reads, with their scales [R, G]."""
    return [(array, arrays[name + SCALE]) for name, array in arrays.items() if array.dtype == np.int8]


def params_from_torch(
    path: Path,
    arrays: Mapping[str, np.ndarray],
    shapes: Mapping[tuple[str, ...], tuple[int, ...]],
    key_from_path: Callable[[tuple[str, ...]], str],
) -> dict[str, Any]:
    """Returns the parameters of a network from arrays in PyTorch's layout, in which kernels are transposed.

    Args:
        path: The file, for error messages.
        arrays: Its arrays by PyTorch's names.
        shapes: Shape of each of our parameters by its path.
        key_from_path: From a path to PyTorch's name.

    Raises:
        UserError: Names, shapes or values are not as expected.
    """
    shapes = {names: shape[::-1] if names[-1] == "kernel" else shape for names, shape in shapes.items()}
    fitted = fit_arrays(path, arrays, {key_from_path(names): (shape, np.float32) for names, shape in shapes.items()})
    leaves = {names: fitted[key_from_path(names)] for names in shapes}
    flat = {names: leaf.T if names[-1] == "kernel" else leaf for names, leaf in leaves.items()}
    return traverse_util.unflatten_dict(flat)


def param_shapes(network: nn.Module, *inputs: jax.Array) -> dict[tuple[str, ...], tuple[int, ...]]:
    """Returns the shape of every parameter of a network by its path."""
    params = jax.eval_shape(lambda: network.init(new_key(0), *inputs))["params"]
    return {names: leaf.shape for names, leaf in traverse_util.flatten_dict(params).items()}


def check_vocabulary(path: Path, tokenizer: Tokenizer, size: int) -> None:
    """Raises `UserError` if a tokenizer has tokens that its encoder does not know."""
    # JAX reads NaN after the end of a table of embeddings, without an error.
    if (largest := largest_token(tokenizer)) >= size:
        raise UserError(f"{path}: the tokenizer has a token {largest}, but its encoder knows {size} tokens")


def encoder_fingerprint(config: Any, variables: dict[str, Any], tokenizer: Tokenizer) -> str:
    """Returns a hash of everything that an embedding depends on."""
    return fingerprint(f"{config}\n{tokenizer.to_str()}\n", variables)
