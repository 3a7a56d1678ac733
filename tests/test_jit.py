"""The comparison of jit and eager: it fails if a function is not compiled, and every such test uses it."""

import ast

import jax
import jax.numpy as jnp
import pytest

from tests.conftest import REPOSITORY
from tests.jit import assert_jit_equals_eager

FILES = sorted(path for path in (REPOSITORY / "tests").rglob("test_*.py") if path.name != "test_jit.py")


def double(values):
    return 2 * values


def test_equal_results_pass():
    assert assert_jit_equals_eager(jax.jit(double), jnp.arange(3.0)).tolist() == [0, 2, 4]


def test_static_and_donated_arguments_and_keys_are_possible():
    def shifted(values, key, *, by, size):
        return values[:size] + by, key

    function = jax.jit(shifted, static_argnames="size", donate_argnums=0)
    values, _ = assert_jit_equals_eager(function, jnp.zeros(4), jax.random.key(1), by=1, size=4)
    assert values.tolist() == [1, 1, 1, 1]


def test_a_function_that_is_not_jitted_fails():
    with pytest.raises(AssertionError, match=r"not under jax\.jit"):
        assert_jit_equals_eager(double, jnp.arange(3.0))


def test_a_function_that_is_another_one_under_jit_fails():
    def differs(values):
        return values + isinstance(values, jax.core.Tracer)

    with pytest.raises(AssertionError, match="assert_trees_all_close failed"):
        assert_jit_equals_eager(jax.jit(differs), jnp.arange(3.0))
    with jax.disable_jit(), pytest.raises(AssertionError, match="assert_trees_all_close failed"):
        assert_jit_equals_eager(jax.jit(differs), jnp.arange(3.0))


def untraced_comparisons(source: str) -> list[str]:
    """Returns the tests that promise a comparison with jit but do it by themselves, so that it may compile nothing."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            names = {getattr(part, "id", getattr(part, "attr", "")) for part in ast.walk(node)}
            promised = {"jit", "jitted", "eager"} & set(node.name.split("_"))
            if "disable_jit" in names or (promised and not {"assert_jit_equals_eager", "compiled_and_eager"} & names):
                found.append(node.name)
    return found


UNTRACED = """
def test_{name}():
    with jax.disable_jit():
        assert jax.jit(double)(3) == double(3)
"""


@pytest.mark.parametrize("name", ["jit_equals_eager", "anything"])
def test_an_untraced_comparison_is_found(name):
    assert untraced_comparisons(UNTRACED.format(name=name)) == [f"test_{name}"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_tests_of_jit_compare_what_is_traced(path):
    assert untraced_comparisons(path.read_text(encoding="utf-8")) == []
