"""One code for NumPy and JAX arrays: arithmetic runs in the library that the arrays come from.

Work on single clips stays in NumPy, where a new length costs nothing; the same functions trace under `jit` and `vmap`.
"""

import types
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

AnyArray = TypeVar("AnyArray", jax.Array, np.ndarray)
"""An array of either library, the same one throughout a signature; it goes inside jaxtyping's brackets."""

EitherArray = jax.Array | np.ndarray
"""An array of either library where nothing ties it to others, as in the fields of a record."""


def namespace_of(*arrays: EitherArray) -> types.ModuleType:
    """Returns `jax.numpy` when any of `arrays` is a JAX array, else `numpy`."""
    return jnp if any(isinstance(array, jax.Array) for array in arrays) else np
