"""A wrong shape is one line that names it. Without a check, most of these would broadcast."""

import jax.numpy as jnp
import jaxtyping
import pytest

from t2m_jax.metrics.codes import code_usage
from t2m_jax.metrics.frechet import fid
from t2m_jax.metrics.positions import joint_errors, mpjpe
from t2m_jax.metrics.quality import measure_errors, measure_quality
from t2m_jax.metrics.retrieval import label_bound, matching_score, r_precision
from t2m_jax.metrics.variety import diversity, multimodality
from t2m_jax.motion.skeleton import HUMANML3D

CLIPS = jnp.ones((2, 5, 22, 3))
MASK = jnp.ones((2, 5), bool)
TEXT = jnp.ones((32, 8))
PAIRS = jnp.zeros((4, 2), int)
REFUSED = {
    "another width": lambda: fid(TEXT, jnp.ones((40, 9))),
    "one embedding": lambda: fid(TEXT, TEXT[0]),
    "one motion for all texts": lambda: matching_score(TEXT, TEXT[:1]),
    "one text": lambda: matching_score(TEXT[0], TEXT[0]),
    "fewer motions": lambda: r_precision(TEXT, TEXT[:16], batch=16),
    "one label for all": lambda: r_precision(TEXT, TEXT, labels=jnp.zeros(1, int)),
    "a batch too small for k": lambda: r_precision(TEXT, TEXT, batch=2),
    "what counts of another set": lambda: label_bound(jnp.zeros(32, int), counted=jnp.ones(1, bool)),
    "first members only": lambda: diversity(TEXT, PAIRS[:, :1]),
    "no axis of captions": lambda: multimodality(TEXT, PAIRS),
    "clips without a batch": lambda: joint_errors(CLIPS[0], CLIPS[0]),
    "one reference for all": lambda: mpjpe(CLIPS, CLIPS[:1], MASK),
    "one mask for all": lambda: mpjpe(CLIPS, CLIPS, MASK[:1]),
    "a reference of one frame": lambda: mpjpe(CLIPS, CLIPS[:, :1], MASK),
    "another skeleton": lambda: measure_quality(CLIPS[:, :, :21], MASK, skeleton=HUMANML3D),
    "a mask of one frame": lambda: measure_quality(CLIPS, MASK[:, :1], skeleton=HUMANML3D),
    "errors from one reference": lambda: measure_errors(CLIPS, CLIPS[:1], MASK, skeleton=HUMANML3D),
    "no codes": lambda: code_usage(jnp.zeros((3, 0), int)),
}


@pytest.fixture
def unchecked(monkeypatch):
    """Turns the shape checks of test runs off: users do not have them."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


@pytest.mark.parametrize("case", REFUSED)
def test_a_wrong_shape_is_refused(case, unchecked):
    with pytest.raises(AssertionError, match=r"^\[Chex\] Assertion assert_\w+ failed: .+$"):
        REFUSED[case]()
