"""Motions as codes, alone and in batches."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints import TrainedTokenizer
from t2m_jax.models.rows import apply_compiled
from t2m_jax.models.system import variable_shapes
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.sampling.programs import BATCH, encode_motions
from tests.tiny import VQVAE, random_variables


@pytest.fixture(scope="module")
def tokenizer():
    normalizer = Normalizer(np.zeros(263, np.float32), np.ones(263, np.float32))
    return TrainedTokenizer(VQVAE, jax.tree.map(jnp.asarray, random_variables(variable_shapes(VQVAE))), normalizer)


@pytest.fixture(scope="module")
def motions():
    generator = np.random.default_rng(0)
    lengths = [40, 64, 3, 41, 70, *generator.integers(4, 60, BATCH)]
    return [generator.normal(size=(length, 263)).astype(np.float32) for length in lengths]


@pytest.mark.slow
def test_batched_codes_equal_those_of_each_motion_alone(tokenizer, motions):
    together = encode_motions(tokenizer, motions)
    assert [len(codes) for codes in together] == [len(motion) // 4 for motion in motions]
    for index in (0, 1, 2, 3, 4, len(motions) - 1):
        np.testing.assert_array_equal(together[index], encode_motions(tokenizer, [motions[index]])[0])
    inputs = (jnp.asarray(motions[0])[None], jnp.ones((1, 40), bool))
    unpadded = apply_compiled(tokenizer.variables, *inputs, module=tokenizer.module, method="encode")[0]
    np.testing.assert_array_equal(together[0], unpadded)
    assert len({tuple(codes.ravel()) for codes in together}) > 60, "codes do not depend on the motion"


def test_the_tokenizer_reads_normalized_motion(tokenizer, motions):
    shifted = tokenizer._replace(normalizer=Normalizer(np.full(263, 5, np.float32), np.full(263, 2, np.float32)))
    expected = encode_motions(tokenizer, motions[:2])
    found = encode_motions(shifted, [2 * motion + 5 for motion in motions[:2]])
    for ours, theirs in zip(found, expected, strict=True):
        assert np.mean(ours == theirs) > 0.9
