"""Each jitted function gives the same with and without compilation, all but trainings optimized as for users."""

import contextlib
import importlib
import inspect
import pkgutil

import jax
import pytest

import t2m_jax
from t2m_jax import train
from tests.jit import assert_jit_equals_eager
from tests.user_settings.cases import CASES

PREFIX = "t2m_jax."


def jitted_functions() -> dict:
    """Returns the functions under `jax.jit` that the modules of the package define, by name."""
    found = {}
    jitted = type(jax.jit(len))
    for info in pkgutil.walk_packages(t2m_jax.__path__, PREFIX):
        if not info.name.endswith("__main__"):
            for name, value in vars(importlib.import_module(info.name)).items():
                if isinstance(value, jitted) and value.__module__ == info.name:
                    found[f"{info.name}.{name}".removeprefix(PREFIX)] = value
    return found


def updates() -> dict:
    """Returns the updates of the trainers of the package under `jax.jit`, by name. `Devices.run` compiles them."""
    found = {}
    for info in pkgutil.iter_modules(train.__path__, f"{PREFIX}train."):
        for name, value in vars(importlib.import_module(info.name)).items():
            if inspect.isfunction(value) and value.__module__ == info.name and name.startswith("update"):
                options = inspect.signature(value).parameters.keys() - {"state", "bank"}
                found[f"{info.name}.{name}".removeprefix(PREFIX)] = jax.jit(value, static_argnames=sorted(options))
    return found


FUNCTIONS = jitted_functions() | updates()


def test_every_compiled_function_has_a_case():
    found = {name.partition(":")[0] for name in CASES}
    assert sorted(FUNCTIONS) == sorted(found), "add the function to tests/user_settings/cases.py, or remove its case"


# To compile these takes longest; `make test-release` compares them. `motion.cleanup.clean_positions` locks feet, too.
LONGEST = ("train.", "evaluation.", "sampling.directing.", "motion.cleanup._lock_clips", "motion.paths._locked")
NAMES = [pytest.param(name, marks=pytest.mark.release) if name.startswith(LONGEST) else name for name in sorted(CASES)]


# Eager functions compile each operation for itself, and this with all optimizations.
@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_jit_equals_eager(name):
    case, function = CASES[name](), FUNCTIONS[name.partition(":")[0]]
    with jax.set_mesh(case.mesh) if case.mesh else contextlib.nullcontext():
        # To compile gradients and random weights with optimizations takes half a minute for each function.
        options = case.options | {"optimize": not name.startswith("train.")}
        assert_jit_equals_eager(function, *case.arguments, rtol=case.rtol, atol=case.atol, **options)
