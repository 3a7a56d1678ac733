"""A tiny model of each kind."""

import pytest

from t2m_jax.sampling import TextToMotion
from tests import tiny


@pytest.fixture(scope="module", params=["gpt", pytest.param("hifigpt", marks=pytest.mark.slow)])
def model(request):
    return TextToMotion(tiny.random_bundle(tiny.BUNDLES[request.param]))
