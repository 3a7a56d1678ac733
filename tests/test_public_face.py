"""What `import t2m_jax` offers."""

import subprocess
import sys
from importlib.metadata import version

import pytest

import t2m_jax
from t2m_jax.errors import UserError
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling import TextToMotion


def test_names_are_those_of_the_parts():
    assert t2m_jax.Motion is Motion
    assert t2m_jax.__version__ == version("t2m-jax")
    assert {"Motion", "__version__", "load"} <= set(dir(t2m_jax))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        t2m_jax.nothing  # noqa: B018 - reading it is the test


def test_models_are_loaded():
    assert type(t2m_jax.load("demo")) is TextToMotion
    with pytest.raises(UserError, match="no such model"):
        t2m_jax.load("nothing")


def test_the_package_is_a_program():
    command = [sys.executable, "-m", "t2m_jax", "--version"]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert result.stdout == f"t2m_jax {t2m_jax.__version__}\n"
