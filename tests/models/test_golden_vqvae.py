"""The VQ-VAE against arrays of the original PyTorch classes."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints.official.load import vqvae_variables
from t2m_jax.losses import reconstruction_loss
from t2m_jax.metrics.codes import perplexity
from t2m_jax.models.vqvae import VqVae, VqVaeConfig
from t2m_jax.motion.skeleton import make_layout
from tests.golden_files import state_dict
from tests.jit import compiled_apply

NAMES = (
    "vqvae_d2_dim263_relu_ema_reset",
    pytest.param("vqvae_d3_dim251_relu_orig", marks=pytest.mark.slow),
    pytest.param("vqvae_d2_dim263_silu_LN_ema", marks=pytest.mark.slow),
    pytest.param("vqvae_d2_dim251_gelu_depth2_reset", marks=pytest.mark.slow),
)


@pytest.fixture(scope="module", params=NAMES)
def case(request, golden_dir):
    arrays = np.load(golden_dir / "t2m_gpt" / f"{request.param}.npz")
    sizes = json.loads(str(arrays["config_json"]))
    config = VqVaeConfig(
        feature_dim=sizes["input_dim"],
        num_codes=sizes["nb_code"],
        code_dim=sizes["code_dim"],
        width=sizes["width"],
        num_stages=sizes["down_t"],
        depth=sizes["depth"],
        dilation_growth=sizes["dilation_growth_rate"],
        activation=sizes["activation"],
        norm=sizes["norm"] or "none",
        quantizer=sizes["quantizer"],
    )
    variables = vqvae_variables(state_dict(arrays), config)
    return arrays, VqVae(config), variables


def test_encoder_and_codes(case):
    arrays, model, variables = case
    for motion, latents, codes in (("x", "z_nct", "code_idx"), ("x_odd", "z_odd_nct", "code_idx_odd")):
        found = compiled_apply(model, variables, jnp.asarray(arrays[motion]), None, train=False, method="_latents")
        np.testing.assert_allclose(found[0], arrays[latents].transpose(0, 2, 1), atol=1e-4, rtol=1e-4)
        np.testing.assert_array_equal(
            compiled_apply(model, variables, jnp.asarray(arrays[motion]), method="encode")[:, :, 0], arrays[codes]
        )


@pytest.mark.slow
def test_reconstruction(case):
    arrays, model, variables = case
    for motion, reconstruction in (("x", "y"), ("x_odd", "y_odd")):
        output = compiled_apply(model, variables, jnp.asarray(arrays[motion]), train=False)
        np.testing.assert_allclose(output.reconstruction, arrays[reconstruction], atol=1e-4, rtol=1e-4)


@pytest.mark.slow
def test_decoding_of_given_codes(case):
    arrays, model, variables = case
    for codes, motion in ((arrays["probe_idx"], "dec_probe"), (arrays["code_idx"][:1], "dec_sample0")):
        decoded = compiled_apply(model, variables, jnp.asarray(codes), method="decode")
        np.testing.assert_allclose(decoded, arrays[motion], atol=1e-4, rtol=1e-4)


@pytest.mark.slow
def test_losses_and_gradient_norms(case):
    arrays, model, variables = case
    motion = jnp.asarray(arrays["x"])
    mask = jnp.ones(motion.shape[:2], bool)
    positions = make_layout(22 if motion.shape[2] == 263 else 21).positions

    def total(params):
        output = model.apply({**variables, "params": params}, motion, train=False)
        recon = reconstruction_loss(output.reconstruction, motion, mask, kind="l1_smooth")
        velocity = reconstruction_loss(output.reconstruction, motion, mask, kind="l1_smooth", features=positions)
        return recon + 0.02 * output.commitment_loss + 0.5 * velocity, (recon, velocity, output)

    (loss, (recon, velocity, output)), gradient = jax.jit(jax.value_and_grad(total, has_aux=True))(variables["params"])
    np.testing.assert_allclose(recon, arrays["recon_loss"], rtol=1e-5)
    np.testing.assert_allclose(velocity, arrays["vel_loss"], rtol=1e-5)
    np.testing.assert_allclose(perplexity(output.code_counts), arrays["perplexity"], rtol=1e-5)
    np.testing.assert_allclose(output.commitment_loss, arrays["loss_commit"], rtol=1e-5)
    np.testing.assert_allclose(loss, arrays["total_loss"], rtol=1e-5)
    weights, norms = state_dict(arrays), state_dict(arrays, "gradnorm/")
    placed = {key: np.full((1,) * weight.ndim, norms.get(key, 0.0)) for key, weight in weights.items()}
    expected = vqvae_variables(placed, model.config)["params"]

    def compare(path, ours, theirs):
        name = jax.tree_util.keystr(path)
        np.testing.assert_allclose(np.linalg.norm(ours), theirs.item(), rtol=1e-4, atol=1e-6, err_msg=name)

    jax.tree_util.tree_map_with_path(compare, gradient, expected)
