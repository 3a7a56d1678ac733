"""Functions that accept NumPy and JAX arrays: they compute in the library of their arguments.

Single clips are processed in NumPy, which does not compile for each new length. The same functions work in `jit` and
`vmap`.
"""

import types
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

AnyArray = TypeVar("AnyArray", jax.Array, np.ndarray)
"""An array of either library, but of the same one throughout a signature. Use it inside jaxtyping's brackets."""

EitherArray = jax.Array | np.ndarray
"""An array of either library, independent of other arrays, as in the fields of a record."""


def namespace_of(*arrays: EitherArray) -> types.ModuleType:
    """Returns `jax.numpy` if any of `arrays` is a JAX array, else `numpy`."""
    return jnp if any(isinstance(array, jax.Array) for array in arrays) else np
