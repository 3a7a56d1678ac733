"""Applying a module to a batch: compiled, or in training with draws that belong to the rows and a compute dtype."""

import functools
from typing import Any, Literal

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Key

Precision = Literal["float32", "bfloat16"]
"""What products are computed in. Parameters, their optimizer's state, losses and statistics are always float32."""


@functools.partial(jax.jit, static_argnames=("module", "method", "train"))
def apply_compiled(variables: Any, *inputs: Any, module: nn.Module, **options: Any) -> Any:
    """Returns the output of a module for a batch; modules with equal configs share their compiled programs.

    Args:
        variables: The collections of the module.
        *inputs: Arrays of the batch.
        module: Takes `inputs`.
        **options: `method` and `train`, if the module needs them.
    """
    return module.apply(variables, *inputs, **options)


def apply_rows(module: nn.Module, variables: Any, *inputs: Any, keys: Key[Array, " B"] | None, **options: Any) -> Any:
    """Returns the output of a module for a batch: as in training with dropout keys, without dropout if they are None.

    Each row has its own key (consumed), because one mask for a batch could not be the same on one and on many devices.

    Args:
        module: Takes `inputs` with the batch as first axis, and `train`. It must not mix rows.
        variables: Its collections.
        *inputs: Arrays of the batch.
        keys: For the RNG stream `dropout`.
        **options: Of `module.apply`, such as `method`.
    """
    if keys is None:  # without draws, rows do not depend on how they are grouped
        return module.apply(variables, *inputs, train=False, **options)

    def apply_row(key: Key[Array, ""], *row: Any) -> Any:
        alone = jax.tree.map(lambda values: values[None], row)
        output = module.apply(variables, *alone, train=True, rngs={"dropout": key}, **options)
        return jax.tree.map(lambda values: values[0], output)

    return jax.vmap(apply_row)(keys, *inputs)


def in_precision(tree: Any, precision: Precision) -> Any:
    """Returns a tree whose float arrays have the dtype that products are computed in."""
    dtype = jnp.dtype(precision)
    return jax.tree.map(lambda leaf: leaf.astype(dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf, tree)
