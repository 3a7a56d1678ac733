"""Contracts and laws of the VQ-VAE."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.models.vqvae import VqVae, VqVaeConfig
from tests.jit import compiled_apply

CONFIG = VqVaeConfig(feature_dim=7, num_codes=8, code_dim=4, width=12, num_stages=2, depth=2)


@pytest.fixture(scope="module")
def model_and_variables():
    model = VqVae(CONFIG)
    variables = jax.jit(lambda key: model.init(key, jnp.zeros((1, 16, 7)), train=False))(jax.random.key(0))
    codebook = jax.random.normal(jax.random.key(1), (8, 4))
    variables["codebook"]["quantizer"]["codebook"] = codebook
    return model, variables


@pytest.mark.slow
def test_shapes(model_and_variables):
    model, variables = model_and_variables
    motion = jnp.zeros((3, 19, 7))
    output = compiled_apply(model, variables, motion, train=False)
    assert output.reconstruction.shape == (3, 16, 7)
    assert output.codes.shape == (3, 4, 1)
    assert compiled_apply(model, variables, output.codes, method="decode").shape == (3, 16, 7)


@pytest.mark.slow
@pytest.mark.parametrize("length", [4, *(pytest.param(length, marks=pytest.mark.release) for length in (9, 13, 18))])
def test_padding_changes_nothing(model_and_variables, length):
    """A clip alone and the same clip in a padded batch, whatever fills the padding."""
    model, variables = model_and_variables
    motion = jax.random.normal(jax.random.key(length), (1, length, 7))
    alone = model.apply(variables, motion, train=False)
    filled = jnp.concatenate([motion, 100.0 * jnp.ones((1, 24 - length, 7))], axis=1)
    batch = jnp.concatenate([filled, jnp.ones((1, 24, 7))])
    mask = jnp.arange(24)[None] < jnp.array([length, 24])[:, None]
    padded = model.apply(variables, batch, mask, train=False)
    num_codes = length // 4
    np.testing.assert_array_equal(padded.codes[0, :num_codes], alone.codes[0])
    np.testing.assert_allclose(padded.reconstruction[0, : 4 * num_codes], alone.reconstruction[0], atol=1e-5, rtol=1e-5)
    code_mask = jnp.arange(6)[None] < num_codes
    codes = jnp.where(code_mask[:, :, None], padded.codes[:1], 7)
    decoded = model.apply(variables, codes, code_mask, method="decode")
    np.testing.assert_allclose(decoded[0, : 4 * num_codes], alone.reconstruction[0], atol=1e-5, rtol=1e-5)


@pytest.mark.slow
def test_codes_are_decoded_as_their_rows_of_the_codebook_and_latents_as_they_are(model_and_variables):
    model, variables = model_and_variables
    codes = jnp.array([[3, 1, 4, 1]])
    rows = variables["codebook"]["quantizer"]["codebook"][codes]
    decoded = compiled_apply(model, variables, codes, method="decode")
    np.testing.assert_array_equal(compiled_apply(model, variables, rows, method="decode_latents"), decoded)
    between = compiled_apply(model, variables, 0.5 * rows + 0.5 * rows[:, ::-1], method="decode_latents")
    assert between.shape == decoded.shape and np.abs(between - decoded).max() > 1e-3


def test_parameter_tree_is_a_file_format(model_and_variables):
    _, variables = model_and_variables
    paths = {
        "/".join(key.key for key in path): leaf.shape for path, leaf in jax.tree_util.tree_leaves_with_path(variables)
    }
    assert len(paths) == 54
    assert paths["params/encoder/down_1/conv/kernel"] == (4, 12, 12)
    assert paths["params/encoder/stack_0/unit_1/dilated/conv/kernel"] == (3, 12, 12)
    assert paths["params/decoder/stack_1/unit_0/pointwise/conv/bias"] == (12,)
    assert paths["params/decoder/up_0/conv/kernel"] == (3, 12, 12)
    assert paths["params/decoder/output/conv/kernel"] == (3, 12, 7)
    assert paths["codebook/quantizer/ema_count"] == (8,)
