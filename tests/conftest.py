"""What every test shares: the CPU, quick compilation, strict broadcasting and the places of reference data."""

import os
from pathlib import Path

# Before the first import of jax, and for the programs that tests start.
os.environ.setdefault("JAX_PLATFORMS", "cpu")
# Tiny models run for milliseconds and compile for seconds: a quarter of the time with the compiler's least effort.
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")

import jax
import pytest
from hypothesis import settings

jax.config.update("jax_numpy_rank_promotion", "raise")

# Compilation makes single examples slow, and a suite should say the same each time.
settings.register_profile("suite", deadline=None, derandomize=True)
settings.load_profile("suite")

REPOSITORY = Path(__file__).parents[1]


@pytest.fixture(scope="session")
def repository() -> Path:
    """Returns the root of the repository."""
    return REPOSITORY


@pytest.fixture(scope="session")
def golden_dir() -> Path:
    """Returns the folder of reference arrays that travel with the tests."""
    return REPOSITORY / "tests" / "golden"


@pytest.fixture(scope="session")
def shared_dir() -> Path:
    """Returns the folder of reference data that may not be passed on; tests that need it skip without it."""
    path = REPOSITORY.parent / "shared"
    if not path.is_dir():
        pytest.skip(f"reference data that the repository may not hold are not at {path}")
    return path
