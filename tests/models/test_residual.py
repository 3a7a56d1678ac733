"""Laws of residual quantization and of the residual VQ-VAE."""

import dataclasses
import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.models.codebook import (
    RULES,
    CodebookState,
    candidate_codes,
    hits,
    initial_codebook,
    make_pool,
    redraw_dead,
    update_codebook,
)
from t2m_jax.models.quantizer import Quantizer, look_up, nearest_codes
from t2m_jax.models.vqvae import RvqVaeConfig, VqVae, VqVaeConfig
from tests.tiny import RVQVAE, random_variables

LATENTS = jax.random.normal(jax.random.key(0), (3, 8, 4))
MASK = jnp.arange(8)[None] < jnp.array([[8], [5], [1]])
EVERYWHERE = jnp.ones((3, 8), bool)


def state_of(codebook) -> CodebookState:
    return CodebookState(codebook, codebook, jnp.ones(len(codebook)), jnp.array(True))


def quantizer(**options) -> Quantizer:
    sizes = {"ema_decay": 0.9, "reset_threshold": 1.0, "num_quantizers": 3}
    return Quantizer(16, 4, "ema_redraw", **(sizes | options))


@functools.partial(jax.jit, static_argnames="module")
def first_variables(module):
    return module.init(jax.random.key(0), LATENTS, MASK, train=False)


@functools.partial(jax.jit, static_argnames="module")
def _step(variables, latents, mask, key, *, module):
    return module.apply(variables, latents, mask, train=True, rngs={"codebook": key}, mutable=["codebook"])


def step(module, variables, latents=LATENTS, mask=MASK, *, seed=1):
    """Returns the output of a training step, and the collections after it."""
    return _step(variables, latents, mask, jax.random.key(seed), module=module)


@pytest.mark.parametrize("seed", range(4))
def test_residuals_never_grow_if_zero_is_a_code(seed):
    """The greedy choice may then take nothing away."""
    codebook = jax.random.normal(jax.random.key(seed), (16, 4)).at[5].set(0.0)
    found, _ = look_up(LATENTS.reshape(-1, 4), state_of(codebook), jnp.ones(6, bool))
    norms = np.linalg.norm(found.residuals, axis=-1)
    assert (norms[1:] <= norms[:-1] + 1e-6).all()
    assert (norms[-1] < norms[0]).mean() > 0.5


@pytest.mark.slow
def test_partial_sums_are_what_the_decoder_reads():
    """The sum over all depths is the quantized latent, to the last bit; so is that of `lookup`, of fewer depths too."""
    module = quantizer()
    _, variables = step(module, first_variables(module))
    output = module.apply(variables, LATENTS, MASK, train=False)
    found, _ = look_up(LATENTS.reshape(-1, 4), state_of(variables["codebook"]["codebook"]), jnp.ones(3, bool))
    np.testing.assert_allclose(output.quantized.reshape(-1, 4), found.totals[-1], atol=1e-6)
    for depth in (1, 2, 3):
        total = module.apply(variables, output.codes[:, :, :depth], method="lookup")
        np.testing.assert_array_equal(total.reshape(-1, 4), found.totals[depth - 1])


@pytest.mark.slow
@pytest.mark.parametrize(("update", "same"), [("joint", True), ("per_depth", False)])
def test_training_and_evaluation_choose_the_same_codes_with_joint_updates(update, same):
    """With an update after each depth, later depths read another codebook than evaluation: the reason for `joint`."""
    module = quantizer(codebook_update=update, ema_decay=0.5)
    _, variables = step(module, first_variables(module))
    before = module.apply(variables, LATENTS, EVERYWHERE, train=False).codes
    during, _ = step(module, variables, mask=EVERYWHERE)
    np.testing.assert_array_equal(during.codes[:, :, 0], before[:, :, 0])
    assert (np.asarray(during.codes) == np.asarray(before)).all() == same


@pytest.mark.slow
@pytest.mark.parametrize("update", ["joint", "per_depth"])
def test_masked_rows_change_nothing(update):
    """Also if they are not numbers."""
    module = quantizer(codebook_update=update)
    hostile = jnp.where(MASK[:, :, None], LATENTS, jnp.nan)
    huge = jnp.where(MASK[:, :, None], LATENTS, 1e6)
    variables = first_variables(module)
    expected, moved = step(module, variables)
    for latents in (hostile, huge):
        output, other = step(module, variables, latents)
        chex.assert_trees_all_equal(other, moved)
        np.testing.assert_array_equal(output.commitment_loss, expected.commitment_loss)
        np.testing.assert_array_equal(output.code_counts, expected.code_counts)
        np.testing.assert_array_equal(output.residual_norms, expected.residual_norms)
        np.testing.assert_array_equal(output.codes[MASK], expected.codes[MASK])
    assert expected.code_counts.sum() == 3 * MASK.sum()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ema_reset", "ema", "reset"])
def test_one_depth_is_the_plain_layer_bit_for_bit(kind):
    """Against the formulas of T2M-GPT's layer, without any loop over depths."""
    module = Quantizer(16, 4, kind, 0.9, 1.0)
    variables, rows, mask = first_variables(module), LATENTS.reshape(-1, 4), MASK.reshape(-1)
    noise = jax.random.normal(jax.random.key(3), (2, 16, 4))
    state = CodebookState(**variables["codebook"])
    for _ in range(3):
        state = initial_codebook(state, candidate_codes(rows, mask, noise[0]))
        codes = nearest_codes(rows, state.codebook)
        batch_hits = hits(rows[None], codes[None], mask[None], num_codes=16)
        candidates = candidate_codes(rows, mask, noise[1]) if RULES[kind].resets else None
        state = update_codebook(state, batch_hits, candidates, rule=RULES[kind], decay=0.9, threshold=1.0)
        output, variables = module.apply(variables, LATENTS, MASK, train=True, noise=noise, mutable=["codebook"])
        np.testing.assert_array_equal(output.codes.reshape(-1), codes)
        chex.assert_trees_all_equal(CodebookState(**variables["codebook"]), state)


@pytest.mark.slow
def test_dead_codes_are_replaced_by_different_vectors():
    vectors = jax.random.normal(jax.random.key(1), (2, 5, 4)).at[0, 0].set(0.0)
    pool = make_pool(vectors, jnp.array([[True] * 5, [True] * 4 + [False]]))
    assert pool.usable.sum() == 8
    state = CodebookState(jnp.full((12, 4), 9.0), jnp.full((12, 4), 9.0), jnp.arange(12.0) / 6, jnp.array(True))
    moved, expired = redraw_dead(state, pool, jax.random.key(0), threshold=1.0, depth=2)
    new = np.asarray(moved.codebook[:6])
    assert len(np.unique(new, axis=0)) == 6
    usable = np.asarray(pool.vectors)[np.asarray(pool.usable)]
    assert all((usable == code).all(axis=1).any() for code in new)
    assert expired.sum() == 6 and (moved.ema_count[:6] == 1).all()
    np.testing.assert_array_equal(moved.codebook[6:], 9.0)
    other, _ = redraw_dead(state, pool, jax.random.key(1), threshold=1.0, depth=2)
    assert (other.codebook[:6] != new).any(), "nothing is drawn"
    off, expired = redraw_dead(state, pool, jax.random.key(0), threshold=0.0, depth=2)
    chex.assert_trees_all_equal(off, state)
    empty, expired = redraw_dead(
        state, pool._replace(usable=jnp.zeros(10, bool)), jax.random.key(0), threshold=1.0, depth=2
    )
    chex.assert_trees_all_equal(empty, state)
    assert expired.sum() == 0


@pytest.mark.slow
def test_depth_dropout_uses_the_first_depths_of_a_step():
    module = quantizer(depth_dropout=1.0)
    variables = first_variables(module)
    used = set()
    for seed in range(12):
        codebook = state_of(variables["codebook"]["codebook"])
        output, variables = step(module, variables, seed=seed)
        counts = np.asarray(output.code_counts.sum(axis=1))
        depth = int((counts > 0).sum())
        assert (counts[:depth] == MASK.sum()).all() and not counts[depth:].any()
        if seed:  # the first step makes the codebook that it reads
            found, _ = look_up(LATENTS.reshape(-1, 4), codebook, jnp.ones(depth, bool))
            np.testing.assert_allclose(output.quantized.reshape(-1, 4), found.totals[-1], atol=1e-6)
        used.add(depth)
    assert used == {1, 2, 3}
    output = module.apply(variables, LATENTS, MASK, train=False)
    assert (output.code_counts.sum(axis=1) == MASK.sum()).all(), "evaluation uses all depths"


@pytest.mark.slow
def test_a_codebook_that_learns_by_gradient_works_with_depths():
    module = Quantizer(16, 4, "orig", 0.9, 1.0, num_quantizers=3)
    variables = module.init(jax.random.key(0), LATENTS, MASK, train=True)

    def loss(params):
        return module.apply({"params": params}, LATENTS, MASK, train=True).commitment_loss

    gradient = jax.grad(loss)(variables["params"])["codebook"]
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0


@pytest.mark.slow
def test_decoder_context_is_as_long_as_needed():
    """A later row changes the frames of a row if and only if it is not farther away than the context."""
    for config in (RVQVAE, VqVaeConfig(num_codes=16, code_dim=8, width=16, depth=2)):
        module, context = VqVae(config), config.decoder_context
        shapes = jax.eval_shape(
            lambda module=module, config=config: module.init(
                jax.random.key(0), jnp.zeros((1, config.downsample, 263)), train=False
            )
        )
        variables = random_variables(shapes, gain=1.0)
        codes = jnp.zeros((1, context + 4, config.num_quantizers), jnp.int32)
        decode = functools.partial(jax.jit(module.apply, static_argnames="method"), variables, method="decode")
        plain, row = decode(codes), 1
        for distance, differs in ((context, True), (context + 1, False)):
            other = decode(codes.at[:, row + distance].set(3))
            frames = slice(row * config.downsample, (row + 1) * config.downsample)
            assert (np.asarray(other)[:, frames] != np.asarray(plain)[:, frames]).any() == differs, distance


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"quantizer": "ema_reset", "codebook_update": "per_depth"}, "codebook_update: per_depth needs quantizer"),
        ({"reset_threshold": 2.0}, "reset_threshold: 2.0 is not between 0 and 1"),
        ({"depth_dropout": 1.5}, "depth_dropout: 1.5 is not a number from 0 to 1"),
        ({"num_quantizers": 0}, "num_quantizers"),
    ],
)
def test_impossible_sizes_are_refused(options, message):
    with pytest.raises((ValueError, UserError), match=message):
        RvqVaeConfig(**options)


def test_the_residual_config_is_the_plain_one_with_other_defaults():
    fields = {field.name for field in dataclasses.fields(VqVaeConfig)}
    assert fields == {field.name for field in dataclasses.fields(RvqVaeConfig)}
    assert VqVaeConfig().num_quantizers == 1 and RvqVaeConfig().downsample == 8
