"""Small batches of one length for small models: what the size changes is a test of its own."""

import pytest

from t2m_jax.evaluation import embedding, sources


@pytest.fixture(scope="package", autouse=True)
def small_batches():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sources, "BATCH", 32)
        patch.setattr(embedding, "BATCH", 32)
        # All motions may be as long as the longest, so that one program generates them.
        patch.setattr(sources, "CHUNK", 64)
        # The longest motions: one program embeds motions of all lengths.
        patch.setattr(embedding, "FRAME_BUCKET", 200)
        yield
