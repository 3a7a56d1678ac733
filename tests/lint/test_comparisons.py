"""Every test that compares jit with eager uses `tests/jit.py`, which fails if a function is not compiled."""

import ast

import pytest

from tests.conftest import REPOSITORY

FILES = sorted(
    path
    for path in (REPOSITORY / "tests").rglob("test_*.py")
    if path.name not in ("test_jit.py", "test_comparisons.py")
)


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


def test_tests_of_jit_compare_what_is_traced():
    assert {path.name: found for path in FILES if (found := untraced_comparisons(path.read_text("utf-8")))} == {}
