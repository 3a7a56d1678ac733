"""Turns XLA's optimizations on, which the rest of the suite does without: see tests/conftest.py."""

import jax
import pytest

SETTING = "JAX_DISABLE_MOST_OPTIMIZATIONS"


@pytest.fixture(scope="package", autouse=True)
def optimizations():
    """Compiles as for users, in this process and in the programs that tests start."""
    # Programs that were compiled with another setting would be used again.
    jax.clear_caches()
    before = jax.config.read(SETTING.lower())
    jax.config.update(SETTING.lower(), False)
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(SETTING, raising=False)
        patch.setenv("T2M_JAX_NO_COMPILATION_CACHE", "1")
        yield
    jax.config.update(SETTING.lower(), before)
    jax.clear_caches()
