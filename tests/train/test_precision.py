"""Options of training that must not change what is learned, or that change only its precision."""

import dataclasses

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.data.banks.motions import Windows
from t2m_jax.text.bpe import CaptionTokens
from t2m_jax.train import LoopConfig, TrainVqVaeConfig
from t2m_jax.train.gpt import TrainGptConfig, gpt_metrics, gpt_train_step, init_gpt_state, make_gpt_batch, make_targets
from t2m_jax.train.vqvae import init_vqvae_state, vqvae_train_step
from tests.tiny import CAPTION_ENCODER, GPT, OPTIMIZER, VQVAE, walking_normalizer

pytestmark = pytest.mark.slow

GPT_TRAINING = TrainGptConfig(
    model=dataclasses.replace(GPT, block_size=9),
    caption_encoder=CAPTION_ENCODER,
    optimizer=OPTIMIZER,
    loop=LoopConfig(batch_size=4),
)
VQVAE_TRAINING = TrainVqVaeConfig(model=VQVAE, window=16, optimizer=OPTIMIZER)

step = jax.jit(gpt_train_step, static_argnames="config")


def batch(config=GPT_TRAINING):
    codes = jax.random.randint(jax.random.key(2), (4, 7), 0, GPT.num_codes)
    targets = make_targets(codes, jnp.array([7, 3, 5, 0]), config=dataclasses.replace(GPT, block_size=9))
    tokens = jax.random.randint(jax.random.key(3), (4, 16), 2, 90)
    captions = CaptionTokens(tokens, jnp.arange(16)[None] < jnp.array([4, 16, 9, 1])[:, None])
    keys = jax.random.split(jax.random.key(4), (4, 2))
    return make_gpt_batch(targets, captions, config=config, dropout_keys=keys)


@pytest.fixture(scope="module")
def state():
    return init_gpt_state(GPT_TRAINING, jax.random.key(0))


@pytest.fixture(scope="module")
def plain(state):
    """State and metrics after one update."""
    return step(state, batch(), config=GPT_TRAINING)


def gradients(state):
    """Returns the gradients but for a factor: Adam's first moments. Parameters move by the sign of rounding, too."""
    return state.opt_state[0].mu


@pytest.mark.release
@pytest.mark.parametrize(
    "change",
    [{"remat": True, "num_parts": 2}, {"num_parts": 2}, {"num_parts": 4}, {"remat": True}],
    ids=["both", "2 parts", "4 parts", "remat"],
)
def test_parts_and_remat_change_nothing(state, plain, change):
    config = dataclasses.replace(GPT_TRAINING, **change)
    other, metrics = step(init_gpt_state(config, jax.random.key(0)), batch(config), config=config)
    chex.assert_trees_all_equal_shapes_and_dtypes(other, plain[0])
    chex.assert_trees_all_close(metrics, plain[1], rtol=1e-6, atol=1e-6)
    chex.assert_trees_all_close(gradients(other), gradients(plain[0]), rtol=0, atol=1e-6)
    assert max(np.abs(leaf).max() for leaf in jax.tree.leaves(gradients(other))) > 1e-3


def test_dropout_of_the_batch_above_is_on(state, plain):
    """Otherwise the test above would not see that parts of a batch have other dropout."""
    _, metrics = step(state, batch()._replace(dropout_keys=None), config=GPT_TRAINING)
    assert abs(metrics["loss"] - plain[1]["loss"]) > 1e-4


def test_parts_must_divide_the_batch():
    with pytest.raises(ValueError, match=r"^num_parts: 3 does not divide loop\.batch_size 4"):
        dataclasses.replace(GPT_TRAINING, num_parts=3)


def test_bfloat16_keeps_the_state_of_a_gpt_in_float32(state, plain):
    config = dataclasses.replace(GPT_TRAINING, precision="bfloat16")
    other, metrics = step(state, batch(config), config=config)
    chex.assert_trees_all_equal_shapes_and_dtypes((other, metrics), plain)
    assert {leaf.dtype for leaf in jax.tree.leaves(metrics)} == {jnp.dtype("float32")}
    assert metrics["loss"] != plain[1]["loss"], "nothing was computed in bfloat16"
    np.testing.assert_allclose(metrics["loss"], plain[1]["loss"], rtol=0.02)


def test_bfloat16_keeps_the_state_of_a_vqvae_in_float32():
    mask = jnp.array([[True] * 16, [True] * 9 + [False] * 7])
    windows = Windows(jax.random.normal(jax.random.key(1), (2, 16, 263)) * mask[:, :, None], mask)
    train = jax.jit(vqvae_train_step, static_argnames="config")
    found = {}
    for precision in ("float32", "bfloat16"):
        config = dataclasses.replace(VQVAE_TRAINING, precision=precision)
        before = init_vqvae_state(config, jax.random.key(0))
        found[precision] = train(before, windows, jax.random.key(4), config=config, normalizer=walking_normalizer())
    after, metrics = found["bfloat16"]
    chex.assert_trees_all_equal_shapes_and_dtypes((after, metrics), found["float32"])
    codebook = after.codebook["quantizer"]["codebook"]
    assert codebook.dtype == jnp.float32
    assert metrics["loss"] != found["float32"][1]["loss"], "nothing was computed in bfloat16"
    np.testing.assert_allclose(metrics["loss"], found["float32"][1]["loss"], rtol=0.05)
    # What the codebook was computed from is rounded; sums and averages of it are not.
    assert np.any(codebook != codebook.astype(jnp.bfloat16))


def products(jaxpr):
    """Returns all matrix products of a program and of the programs in it."""
    found = []
    for equation in jaxpr.eqns:
        if equation.primitive.name == "dot_general":
            found.append(equation)
        for value in jax.tree.leaves(equation.params, is_leaf=lambda leaf: hasattr(leaf, "eqns")):
            inner = getattr(value, "jaxpr", value)
            if hasattr(inner, "eqns"):
                found += products(inner)
    return found


def dtypes(variables):
    return {variable.aval.dtype for variable in variables}


@pytest.mark.parametrize("remat", [False, True])
def test_no_product_of_a_gpt_in_bfloat16_is_in_float32(state, remat):
    """A table of positions in float32 would turn all products after it into float32."""
    config = dataclasses.replace(GPT_TRAINING, precision="bfloat16", remat=remat)

    def forward(params, batch):
        return gpt_metrics(params, batch, config=config, precision="bfloat16")

    found = products(jax.make_jaxpr(forward)(state.params, batch(config)).jaxpr)
    num_blocks = GPT.num_layers + CAPTION_ENCODER.num_layers
    assert len(found) > 7 * num_blocks
    assert all(dtypes(equation.invars) == {jnp.dtype("bfloat16")} for equation in found)
    scores = [equation for equation in found if dtypes(equation.outvars) == {jnp.dtype("float32")}]
    assert len(scores) == num_blocks, "only the scores of attention are summed up in float32"
    full = products(jax.make_jaxpr(lambda *given: gpt_metrics(*given, config=config))(state.params, batch()).jaxpr)
    assert all(dtypes(equation.invars) == {jnp.dtype("float32")} for equation in full)
