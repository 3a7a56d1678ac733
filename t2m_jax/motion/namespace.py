"""One code for NumPy and JAX arrays: arithmetic runs in the library that the arrays come from.

Work on single clips stays in NumPy, where a new length costs nothing; the same functions trace under `jit` and `vmap`.
"""

import types

import jax
import jax.numpy as jnp
import numpy as np

AnyArray = jax.Array | np.ndarray
"""An array of either library; it goes inside jaxtyping's brackets."""


def namespace_of(*arrays: AnyArray) -> types.ModuleType:
    """Returns `jax.numpy` when any of `arrays` is a JAX array, else `numpy`."""
    return jnp if any(isinstance(array, jax.Array) for array in arrays) else np
