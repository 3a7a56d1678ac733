"""Compares a function compiled by `jax.jit`, as for users, with the same function run operation by operation."""

import contextlib
import copy
import functools
import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import chex
import jax
import jax.numpy as jnp
import pytest

SETTING = "jax_disable_most_optimizations"
"""Set in tests/conftest.py, because the suite mostly compiles. Users have XLA's optimizations."""


@contextlib.contextmanager
def optimized() -> Iterator[None]:
    """Compiles new programs as for users; those that were compiled before are not compiled again."""
    before = jax.config.read(SETTING)
    jax.config.update(SETTING, False)
    yield
    jax.config.update(SETTING, before)


@contextlib.contextmanager
def process_of_user(monkeypatch: pytest.MonkeyPatch) -> Iterator[ProcessPoolExecutor]:
    """Gives the body a process that compiles with the settings of users, for programs whose last bits matter."""
    monkeypatch.delenv(SETTING.upper())
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
        yield process


@functools.partial(jax.jit, static_argnums=0, static_argnames=("method", "train", "capture_intermediates"))
def compiled_apply(module: Any, variables: Any, *arguments: Any, **options: Any) -> Any:
    """Returns the result of `module.apply` as one program; without jit, every operation is compiled for every shape."""
    return module.apply(variables, *arguments, **options)


def without_keys(tree: Any) -> Any:
    """Returns a tree whose random keys are replaced by their bits, which can be compared."""

    def bits(leaf: Any) -> Any:
        return jax.random.key_data(leaf) if jnp.issubdtype(jnp.result_type(leaf), jax.dtypes.prng_key) else leaf

    return jax.tree.map(bits, tree)


def compiled_and_eager(function: Callable, *arguments: Any, optimize: bool = True, **options: Any) -> tuple[Any, Any]:
    """Returns the results of a jitted function with and without compilation, random keys as bits.

    The function is compiled ahead of time, by default with optimizations. So the first result cannot come from Python
    code, not even inside `jax.disable_jit()`, nor from a program that a test compiled without optimizations.

    Raises:
        AssertionError: `function` is not under `jax.jit`.
    """
    assert isinstance(function, type(jax.jit(lambda: None))), f"{function} is not under jax.jit"
    with jax.disable_jit():
        eager = function(*arguments, **options)
    with jax.disable_jit(False), optimized() if optimize else contextlib.nullcontext():
        lowered = function.lower(*arguments, **options)
        # Static options are part of the program.
        dynamic = {name: value for name, value in options.items() if name in lowered.args_info[1]}
        # Copies, because the program may write into donated arguments, which may be part of the other result.
        compiled = lowered.compile()(*copy.deepcopy(arguments), **dynamic)
    return without_keys(compiled), without_keys(eager)


def assert_jit_equals_eager(
    function: Callable, *arguments: Any, rtol: float = 1e-5, atol: float = 0.0, optimize: bool = True, **options: Any
) -> Any:
    """Fails if the results of a jitted function differ with and without compilation, and returns the former.

    Args:
        function: A function under `jax.jit`. Its static arguments must be among the options.
        *arguments: Of the function.
        rtol: Relative tolerance.
        atol: Absolute tolerance.
        optimize: Whether it is compiled with the optimizations that users have.
        **options: Of the function.
    """
    compiled, eager = compiled_and_eager(function, *arguments, optimize=optimize, **options)
    chex.assert_trees_all_equal_shapes_and_dtypes(compiled, eager)
    chex.assert_trees_all_close(compiled, eager, rtol=rtol, atol=atol)
    return compiled
