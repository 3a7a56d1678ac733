"""What users meet when a shape is wrong: the checks of the package, without those of test runs."""

import jaxtyping
import pytest


@pytest.fixture
def unchecked(monkeypatch):
    """Turns the shape checks of test runs off."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
