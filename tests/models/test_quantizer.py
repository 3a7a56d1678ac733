"""The codebook's learning rule: golden sequences, safety at zero counts, masks."""

import json

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.metrics.codes import perplexity
from t2m_jax.models.codebook import (
    CANDIDATE_NOISE,
    RULES,
    CodebookState,
    candidate_codes,
    hits,
    initial_codebook,
    update_codebook,
)
from t2m_jax.models.quantizer import Quantizer, nearest_codes


def fresh_state(num_codes: int, code_dim: int) -> CodebookState:
    zeros = jnp.zeros((num_codes, code_dim))
    return CodebookState(zeros, zeros, jnp.zeros(num_codes), jnp.array(False))


GOLDEN = {
    "quantizer_ema_reset_big": "ema_reset",
    "quantizer_ema_reset_tile": "ema_reset",
    "quantizer_ema_big": "ema",
    "quantizer_reset_big": "reset",
}


def call(module, variables, latents, mask):
    """Returns output and updated collections of one training step."""
    return module.apply(
        variables, latents, mask, train=True, rngs={"codebook": jax.random.key(1)}, mutable=["codebook"]
    )


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_sequence(golden_dir, name):
    arrays = np.load(golden_dir / "t2m_gpt" / f"{name}.npz")
    sizes = json.loads(str(arrays["config_json"]))
    num_codes, decay = sizes["nb_code"], sizes.get("effective_mu") or 0.99
    state = initial_codebook(fresh_state(num_codes, sizes["code_dim"]), jnp.asarray(arrays["init_candidates"]))
    for step, latents in enumerate(arrays["x_nct"]):
        rows = jnp.asarray(latents.transpose(0, 2, 1).reshape(-1, sizes["code_dim"]))
        np.testing.assert_allclose(state.codebook, arrays["codebook_used"][step], atol=1e-5)
        codes = nearest_codes(rows, state.codebook)
        np.testing.assert_array_equal(codes.reshape(arrays["code_idx"][step].shape), arrays["code_idx"][step])
        batch_hits = hits(rows[None], codes[None], jnp.ones((1, len(rows)), bool), num_codes=num_codes)
        candidates = jnp.asarray(arrays["reset_candidates"][step]) if RULES[GOLDEN[name]].resets else None
        state = update_codebook(state, batch_hits, candidates, rule=RULES[GOLDEN[name]], decay=decay, threshold=1.0)
        np.testing.assert_allclose(state.codebook, arrays["codebook_after"][step], atol=1e-5)
        np.testing.assert_allclose(state.ema_count, arrays["code_count_after"][step], atol=1e-6)
        if RULES[GOLDEN[name]].averages:
            np.testing.assert_allclose(state.ema_sum, arrays["code_sum_after"][step], atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ema_reset", "ema", "reset"])
def test_module_learns_as_the_golden_sequence(golden_dir, kind):
    """With more rows than codes nothing is random, so the whole module can be compared, gradients included."""
    arrays = np.load(golden_dir / "t2m_gpt" / f"quantizer_{kind}_big.npz")
    sizes = json.loads(str(arrays["config_json"]))
    module = Quantizer(sizes["nb_code"], sizes["code_dim"], kind, sizes.get("effective_mu") or 0.99, 1.0)
    first = jnp.asarray(arrays["x_nct"][0].transpose(0, 2, 1))
    mask = jnp.ones(first.shape[:2], bool)
    variables = module.init(jax.random.key(0), first, mask, train=True)
    assert not variables["codebook"]["initialised"]
    for step, latents in enumerate(arrays["x_nct"]):
        latents = jnp.asarray(latents.transpose(0, 2, 1))
        probe = jnp.asarray(arrays["probe_r"][step].transpose(0, 2, 1))

        def scalar(latents, variables=variables, probe=probe):
            output, updates = call(module, variables, latents, mask)
            return output.commitment_loss + jnp.sum(output.quantized * probe), (output, updates)

        (_, (output, updates)), gradient = jax.value_and_grad(scalar, has_aux=True)(latents)
        np.testing.assert_array_equal(output.codes[:, :, 0], arrays["code_idx"][step])
        np.testing.assert_allclose(output.commitment_loss, arrays["loss"][step], rtol=1e-5)
        np.testing.assert_allclose(output.quantized.transpose(0, 2, 1), arrays["out_nct"][step], atol=1e-5)
        np.testing.assert_allclose(gradient.transpose(0, 2, 1), arrays["grad_x_nct"][step], atol=1e-5)
        found = perplexity(output.code_counts)
        np.testing.assert_allclose(found, arrays["perplexity"][step], rtol=1e-5)
        np.testing.assert_allclose(updates["codebook"]["codebook"], arrays["codebook_after"][step], atol=1e-5)
        variables = updates
    latents = jnp.asarray(arrays["eval_x_nct"].transpose(0, 2, 1))
    output = module.apply(variables, latents, jnp.ones(latents.shape[:2], bool), train=False)
    np.testing.assert_array_equal(output.codes[:, :, 0], arrays["eval_code_idx"])
    np.testing.assert_allclose(output.commitment_loss, arrays["eval_loss"], rtol=1e-5)


@pytest.mark.slow
def test_a_codebook_that_learns_by_gradient(golden_dir):
    """The original's naive quantizer: its loss, the gradient of table and latents, and six steps of plain descent."""
    arrays = np.load(golden_dir / "t2m_gpt" / "quantizer_orig.npz")
    sizes = json.loads(str(arrays["config_json"]))
    module = Quantizer(sizes["nb_code"], sizes["code_dim"], "orig", 0.99, 1.0)
    mask = jnp.ones(arrays["code_idx"].shape[1:], bool)
    params = {"codebook": jnp.asarray(arrays["codebook_initial"])}
    for step, latents in enumerate(arrays["x_nct"]):
        latents = jnp.asarray(latents.transpose(0, 2, 1))
        probe = jnp.asarray(arrays["probe_r"][step].transpose(0, 2, 1))

        def scalar(params, latents, probe=probe):
            output, updates = call(module, {"params": params}, latents, mask)
            assert not updates, "the codebook is a parameter, nothing else moves it"
            return output.commitment_loss + jnp.sum(output.quantized * probe), output

        (table, rows), output = jax.grad(scalar, argnums=(0, 1), has_aux=True)(params, latents)
        np.testing.assert_array_equal(output.codes[:, :, 0], arrays["code_idx"][step])
        np.testing.assert_allclose(output.commitment_loss, arrays["loss"][step], rtol=1e-5)
        np.testing.assert_allclose(table["codebook"], arrays["grad_embedding"][step], atol=1e-6)
        np.testing.assert_allclose(rows.transpose(0, 2, 1), arrays["grad_x_nct"][step], atol=1e-5)
        params = {"codebook": params["codebook"] - sizes["sgd_lr"] * table["codebook"]}
        np.testing.assert_allclose(params["codebook"], arrays["codebook_after"][step], atol=1e-5)


@pytest.mark.slow
def test_the_initial_table_of_the_naive_quantizer_is_small():
    module = Quantizer(64, 8, "orig", 0.99, 1.0)
    latents = jnp.zeros((1, 2, 8))
    variables = module.init(jax.random.key(0), latents, jnp.ones((1, 2), bool), train=True)
    assert set(variables) == {"params"}
    table = np.asarray(variables["params"]["codebook"])
    assert 0.9 / 64 < np.abs(table).max() <= 1 / 64


def test_averages_of_codes_that_nobody_chose_for_ages_keep_their_place():
    """Counts that decayed to nothing must not turn into a ratio of leftovers."""
    state = CodebookState(jnp.ones((3, 2)), jnp.full((3, 2), 1e-38), jnp.full(3, 1e-39), jnp.array(True))
    rule = RULES["ema"]
    moved = update_codebook(state, (jnp.zeros((3, 2)), jnp.zeros(3)), None, rule=rule, decay=0.99, threshold=1.0)
    np.testing.assert_array_equal(moved.codebook, 1.0)


def test_evaluation_leaves_the_codebook_alone():
    module = Quantizer(8, 4, "ema_reset", 0.99, 1.0)
    latents, mask = jax.random.normal(jax.random.key(0), (2, 6, 4)), jnp.ones((2, 6), bool)
    variables = module.init(jax.random.key(0), latents, mask, train=False)
    _, updates = module.apply(variables, latents, mask, train=False, mutable=["codebook"])
    for before, after in zip(jax.tree.leaves(variables), jax.tree.leaves(updates), strict=True):
        np.testing.assert_array_equal(before, after)


@pytest.mark.slow
def test_a_quantizer_of_bfloat16_latents_computes_in_float32():
    module = Quantizer(8, 4, "ema_reset", 0.99, 1.0)
    latents, mask = jax.random.normal(jax.random.key(0), (2, 6, 4), jnp.bfloat16), jnp.ones((2, 6), bool)
    variables = module.init(jax.random.key(0), latents, mask, train=True)
    output, updates = call(module, variables, latents, mask)
    exact, exact_updates = call(module, variables, latents.astype(jnp.float32), mask)
    assert output.quantized.dtype == jnp.bfloat16
    assert output.commitment_loss.dtype == output.code_counts.dtype == jnp.float32
    np.testing.assert_array_equal(output.codes, exact.codes)
    np.testing.assert_array_equal(output.commitment_loss, exact.commitment_loss)
    np.testing.assert_array_equal(output.quantized, exact.quantized.astype(jnp.bfloat16))
    chex.assert_trees_all_equal(updates, exact_updates)
    assert updates["codebook"]["codebook"].dtype == jnp.float32


def test_zero_counts_stay_finite_in_value_and_gradient():
    state = CodebookState(jnp.ones((3, 2)), jnp.zeros((3, 2)), jnp.zeros(3), jnp.array(True))

    def total(sums):
        candidates = jnp.full((3, 2), 5.0)
        updated = update_codebook(
            state, (sums, jnp.zeros(3)), candidates, rule=RULES["ema_reset"], decay=0.99, threshold=1.0
        )
        return jnp.sum(updated.codebook), updated.codebook

    (_, codebook), gradient = jax.value_and_grad(total, has_aux=True)(jnp.zeros((3, 2)))
    np.testing.assert_array_equal(codebook, 5.0)
    assert np.all(np.isfinite(gradient))


def test_candidates_skip_masked_rows():
    latents = jnp.arange(12.0).reshape(6, 2)
    mask = jnp.array([False, True, False, True, True, True])
    candidates = candidate_codes(latents, mask, jax.random.normal(jax.random.key(0), (3, 2)))
    np.testing.assert_array_equal(candidates, latents[jnp.array([1, 3, 4])])


def test_candidates_repeat_with_noise_when_rows_are_few():
    latents = jnp.ones((2, 4))
    candidates = candidate_codes(latents, jnp.array([True, False]), jax.random.normal(jax.random.key(0), (5, 4)))
    assert len(np.unique(np.asarray(candidates), axis=0)) == 5
    np.testing.assert_allclose(candidates, 1.0, atol=0.05)


def test_masked_rows_do_not_count():
    rows = jnp.array([[1.0, 0.0], [9.0, 9.0]])
    sums, counts = hits(rows[None], jnp.array([[1, 1]]), jnp.array([[True, False]]), num_codes=2)
    np.testing.assert_array_equal(sums, [[0.0, 0.0], [1.0, 0.0]])
    np.testing.assert_array_equal(counts, [0.0, 1.0])


@pytest.mark.slow
def test_given_noise_replaces_drawn_noise(golden_dir):
    """With fewer rows than codes, the reference draws noise. Given the same noise, the module learns the same codes."""
    arrays = np.load(golden_dir / "t2m_gpt" / "quantizer_ema_reset_tile.npz")
    sizes = json.loads(str(arrays["config_json"]))
    num_codes, code_dim = sizes["nb_code"], sizes["code_dim"]
    module = Quantizer(num_codes, code_dim, "ema_reset", sizes.get("effective_mu") or 0.99, 1.0)
    first = jnp.asarray(arrays["x_nct"][0].transpose(0, 2, 1))
    mask = jnp.ones(first.shape[:2], bool)
    variables = module.init(jax.random.key(0), first, mask, train=True)
    for step, latents in enumerate(arrays["x_nct"]):
        latents = latents.transpose(0, 2, 1)
        rows = np.resize(latents.reshape(-1, code_dim), (num_codes, code_dim))
        drawn = np.stack([arrays["init_candidates"], arrays["reset_candidates"][step]]) - rows
        noise = jnp.asarray(drawn / (CANDIDATE_NOISE * code_dim**-0.5))
        _, variables = module.apply(
            variables, jnp.asarray(latents), mask, train=True, noise=noise, mutable=["codebook"]
        )
        np.testing.assert_allclose(variables["codebook"]["codebook"], arrays["codebook_after"][step], atol=1e-5)
