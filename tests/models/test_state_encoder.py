"""The network over token states: what it reads, what it does not, and its parameters."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import traverse_util

from t2m_jax.models.caption_encoder import StateEncoder, StateEncoderConfig, init_network
from t2m_jax.models.rows import apply_rows
from tests.jit import compiled_apply
from tests.tiny import random_variables

CONFIG = StateEncoderConfig(
    state_dim=6, max_length=8, embed_dim=8, num_layers=1, num_heads=2, text_dim=5, dropout=0.0, token_dropout=0.5
)
MODULE = StateEncoder(CONFIG)
STATES = jax.random.normal(jax.random.key(1), (2, 7, 6))
MASK = jnp.arange(7)[None] < jnp.array([4, 7])[:, None]


@pytest.fixture(scope="module")
def variables():
    return random_variables(jax.eval_shape(lambda: init_network(CONFIG, jax.random.key(0))))


def embed(variables, states=STATES, mask=MASK):
    return compiled_apply(MODULE, variables, states, mask, train=False)


@pytest.mark.slow
def test_states_past_the_end_and_their_number_have_no_influence(variables):
    found = embed(variables)
    np.testing.assert_allclose(embed(variables, jnp.where(MASK[..., None], STATES, 9.0)), found, atol=1e-6)
    np.testing.assert_allclose(embed(variables, STATES[:1, :4], MASK[:1, :4]), found[:1], atol=1e-6)
    assert np.abs(embed(variables, STATES.at[0, 3, 0].add(3.0)) - found)[0].max() > 1e-3


def test_the_order_of_states_matters(variables):
    found = embed(variables)
    assert np.abs(embed(variables, STATES[:, [0, 2, 1, 3, 4, 5, 6]]) - found).max(axis=1).min() > 1e-2


@pytest.mark.slow
def test_training_hides_tokens_but_never_the_first(variables):
    keys = jax.random.split(jax.random.key(3), 200)
    states, mask = (jnp.repeat(array[1:], 200, axis=0) for array in (STATES, MASK))
    embedded = apply_rows(MODULE, variables, states, mask, keys=keys)
    # One embedding for each set of tokens that may be left, of which there are 2 ** 6.
    num_kinds = len(np.unique(np.asarray(embedded).round(5), axis=0))
    assert np.isfinite(embedded).all() and 40 < num_kinds <= 64
    alone = apply_rows(MODULE, variables, states[:, :1], mask[:, :1], keys=keys)
    np.testing.assert_allclose(alone, jnp.broadcast_to(alone[:1], alone.shape), atol=1e-6)
    np.testing.assert_allclose(apply_rows(MODULE, variables, STATES, MASK, keys=None), embed(variables), atol=1e-6)


def test_the_parameters_have_these_names():
    found = traverse_util.flatten_dict(jax.eval_shape(lambda: init_network(CONFIG, jax.random.key(0)))["params"])
    assert {"/".join(path): leaf.shape for path, leaf in found.items() if path[0] != "block_0"} == {
        "position_embedding": (8, 8),
        "state_norm/scale": (6,),
        "state_norm/bias": (6,),
        "reduce/kernel": (6, 8),
        "reduce/bias": (8,),
        "final_norm/scale": (8,),
        "final_norm/bias": (8,),
        "projection/kernel": (8, 5),
        "projection/bias": (5,),
    }


@pytest.mark.parametrize("changes", [{"token_dropout": 1.0}, {"num_heads": 3}, {"max_length": 0}, {"state_dim": 10**6}])
def test_sizes_that_make_no_sense_are_refused(changes):
    with pytest.raises(ValueError, match=next(iter(changes))):
        dataclasses.replace(CONFIG, **changes)


def test_states_of_another_width_are_refused(variables):
    with pytest.raises(AssertionError):
        embed(variables, STATES[..., :5])
