"""A tiny model of each kind."""

import pytest

from t2m_jax.sampling import TextToMotion
from tests import tiny


@pytest.fixture(scope="module", params=["gpt", pytest.param("hifigpt", marks=pytest.mark.slow)])
def model(request):
    return TextToMotion(tiny.random_bundle(tiny.BUNDLES[request.param]))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Leaves slow tests with T2M-GPT to `make test-release`: they run with T2M-HiFiGPT, and tests/cli has journeys.

    Those that ask less of T2M-HiFiGPT's random weights have the mark `both`.
    """
    for item in items:
        parameters = item.callspec.params if hasattr(item, "callspec") else {}
        is_gpt = item.path.parent.name == "sampling" and parameters.get("model") == "gpt"
        if is_gpt and item.get_closest_marker("slow") and not item.get_closest_marker("both"):
            item.add_marker(pytest.mark.release)
