"""Small batches of two lengths for small models: what the size changes is a test of its own."""

import pytest

from t2m_jax.evaluation import embedding, sources


@pytest.fixture(scope="package", autouse=True)
def small_batches():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sources, "BATCH", 32)
        patch.setattr(embedding, "BATCH", 32)
        # Half of the longest motions: two programs embed motions of all lengths.
        patch.setattr(embedding, "FRAME_BUCKET", 100)
        yield
