"""The comparison of compiled functions with eager ones, which several tests share."""

from collections.abc import Callable
from typing import Any

import chex
import jax


def assert_jit_matches_eager(function: Callable[..., Any], *arguments: Any, rtol: float = 1e-5, atol: float = 0) -> Any:
    """Returns the results of the compiled function, after comparing them with a run of one operation at a time."""
    traced = []

    def traced_function(*arguments: Any) -> Any:
        # `jax.disable_jit` turns `jax.jit` off silently. Without this record, two eager runs could be compared.
        traced.append(any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arguments)))
        return function(*arguments)

    compiled = jax.jit(traced_function)(*arguments)
    assert traced == [True], "the function was not compiled"
    with jax.disable_jit():
        eager = function(*arguments)
    chex.assert_trees_all_close(compiled, eager, rtol=rtol, atol=atol)
    return compiled
