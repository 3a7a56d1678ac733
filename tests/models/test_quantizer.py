"""The codebook's learning rule: golden sequences, safety at zero counts, masks."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.models.quantizer import (
    CodebookState,
    Quantizer,
    candidate_codes,
    hits,
    initial_codebook,
    nearest_codes,
    update_codebook,
)


def fresh_state(num_codes: int, code_dim: int) -> CodebookState:
    zeros = jnp.zeros((num_codes, code_dim))
    return CodebookState(zeros, zeros, jnp.zeros(num_codes), jnp.array(False))


@pytest.mark.parametrize("name", ["quantizer_ema_reset_big", "quantizer_ema_reset_tile"])
def test_golden_sequence(golden_dir, name):
    arrays = np.load(golden_dir / "t2m_gpt" / f"{name}.npz")
    sizes = json.loads(str(arrays["config_json"]))
    num_codes = sizes["nb_code"]
    state = initial_codebook(fresh_state(num_codes, sizes["code_dim"]), jnp.asarray(arrays["init_candidates"]))
    for step, latents in enumerate(arrays["x_nct"]):
        rows = jnp.asarray(latents.transpose(0, 2, 1).reshape(-1, sizes["code_dim"]))
        np.testing.assert_allclose(state.codebook, arrays["codebook_used"][step], atol=1e-5)
        codes = nearest_codes(rows, state.codebook)
        np.testing.assert_array_equal(codes.reshape(arrays["code_idx"][step].shape), arrays["code_idx"][step])
        batch_hits = hits(rows, codes, jnp.ones(len(rows), bool), num_codes=num_codes)
        candidates = jnp.asarray(arrays["reset_candidates"][step])
        state = update_codebook(state, batch_hits, candidates, decay=sizes["effective_mu"], threshold=1.0)
        np.testing.assert_allclose(state.codebook, arrays["codebook_after"][step], atol=1e-5)
        np.testing.assert_allclose(state.ema_count, arrays["code_count_after"][step], atol=1e-6)
        np.testing.assert_allclose(state.ema_sum, arrays["code_sum_after"][step], atol=1e-5)


def test_module_learns_as_the_golden_sequence(golden_dir):
    """With more rows than codes nothing is random, so the whole module can be compared, gradients included."""
    arrays = np.load(golden_dir / "t2m_gpt" / "quantizer_ema_reset_big.npz")
    sizes = json.loads(str(arrays["config_json"]))
    module = Quantizer(sizes["nb_code"], sizes["code_dim"], sizes["effective_mu"], 1.0)
    first = jnp.asarray(arrays["x_nct"][0].transpose(0, 2, 1))
    mask = jnp.ones(first.shape[:2], bool)
    variables = module.init(jax.random.key(0), first, mask, train=True)
    assert not variables["codebook"]["initialised"]
    for step, latents in enumerate(arrays["x_nct"]):
        latents = jnp.asarray(latents.transpose(0, 2, 1))
        probe = jnp.asarray(arrays["probe_r"][step].transpose(0, 2, 1))

        def scalar(latents, variables=variables, probe=probe):
            output, updates = module.apply(
                variables, latents, mask, train=True, rngs={"codebook": jax.random.key(1)}, mutable=["codebook"]
            )
            return output.commitment_loss + jnp.sum(output.quantized * probe), (output, updates)

        (_, (output, updates)), gradient = jax.value_and_grad(scalar, has_aux=True)(latents)
        np.testing.assert_array_equal(output.codes, arrays["code_idx"][step])
        np.testing.assert_allclose(output.commitment_loss, arrays["loss"][step], rtol=1e-5)
        np.testing.assert_allclose(output.quantized.transpose(0, 2, 1), arrays["out_nct"][step], atol=1e-5)
        np.testing.assert_allclose(gradient.transpose(0, 2, 1), arrays["grad_x_nct"][step], atol=1e-5)
        np.testing.assert_allclose(updates["codebook"]["codebook"], arrays["codebook_after"][step], atol=1e-5)
        variables = updates


def test_evaluation_leaves_the_codebook_alone():
    module = Quantizer(8, 4, 0.99, 1.0)
    latents, mask = jax.random.normal(jax.random.key(0), (2, 6, 4)), jnp.ones((2, 6), bool)
    variables = module.init(jax.random.key(0), latents, mask, train=False)
    _, updates = module.apply(variables, latents, mask, train=False, mutable=["codebook"])
    for before, after in zip(jax.tree.leaves(variables), jax.tree.leaves(updates), strict=True):
        np.testing.assert_array_equal(before, after)


def test_zero_counts_stay_finite_in_value_and_gradient():
    state = CodebookState(jnp.ones((3, 2)), jnp.zeros((3, 2)), jnp.zeros(3), jnp.array(True))

    def total(sums):
        updated = update_codebook(state, (sums, jnp.zeros(3)), jnp.full((3, 2), 5.0), decay=0.99, threshold=1.0)
        return jnp.sum(updated.codebook), updated.codebook

    (_, codebook), gradient = jax.value_and_grad(total, has_aux=True)(jnp.zeros((3, 2)))
    np.testing.assert_array_equal(codebook, 5.0)
    assert np.all(np.isfinite(gradient))


def test_candidates_skip_masked_rows():
    latents = jnp.arange(12.0).reshape(6, 2)
    mask = jnp.array([False, True, False, True, True, True])
    candidates = candidate_codes(latents, mask, jax.random.key(0), num_codes=3)
    np.testing.assert_array_equal(candidates, latents[jnp.array([1, 3, 4])])


def test_candidates_repeat_with_noise_when_rows_are_few():
    latents = jnp.ones((2, 4))
    candidates = candidate_codes(latents, jnp.array([True, False]), jax.random.key(0), num_codes=5)
    assert len(np.unique(np.asarray(candidates), axis=0)) == 5
    np.testing.assert_allclose(candidates, 1.0, atol=0.05)


def test_masked_rows_do_not_count():
    rows = jnp.array([[1.0, 0.0], [9.0, 9.0]])
    sums, counts = hits(rows, jnp.array([1, 1]), jnp.array([True, False]), num_codes=2)
    np.testing.assert_array_equal(sums, [[0.0, 0.0], [1.0, 0.0]])
    np.testing.assert_array_equal(counts, [0.0, 1.0])
