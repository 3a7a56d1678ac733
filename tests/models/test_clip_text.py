"""CLIP's text tower: sizes, causality, where a caption is read."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.models.clip_text import ClipText, ClipTextConfig, quick_gelu
from tests.tiny import random_variables

CONFIG = ClipTextConfig(
    vocabulary_size=20, max_length=9, embed_dim=8, num_layers=2, num_heads=2, mlp_dim=24, text_dim=6, end_token=17
)
LEGACY = ClipTextConfig(
    vocabulary_size=20, max_length=9, embed_dim=8, num_layers=2, num_heads=2, mlp_dim=24, text_dim=6
)
TOKENS = np.array([[16, 3, 5, 17, 17, 17, 17, 17, 17], [16, 4, 4, 8, 2, 9, 1, 0, 17]], np.int32)


def shapes(config: ClipTextConfig):
    tokens = jnp.zeros((1, config.max_length), jnp.int32)
    return jax.eval_shape(lambda: ClipText(config).init(jax.random.key(0), tokens))


@pytest.fixture(scope="module")
def variables():
    return random_variables(shapes(CONFIG))


@functools.partial(jax.jit, static_argnames="config")
def apply(variables, tokens, *, config):
    return ClipText(config).apply(variables, tokens)


def embed(config, variables, tokens):
    return np.asarray(apply(variables, jnp.asarray(tokens), config=config))


def test_the_default_is_the_text_tower_of_vit_b_32():
    leaves = jax.tree.leaves(shapes(ClipTextConfig()))
    without_projection = 63_165_952
    assert sum(math.prod(leaf.shape) for leaf in leaves) == without_projection + 512 * 512


def test_the_parameter_tree_is_a_file_format():
    found = {jax.tree_util.keystr(path, simple=True, separator="/") for path, _ in _leaves(shapes(CONFIG)["params"])}
    blocks = {
        f"block_{layer}/{part}"
        for layer in range(2)
        for part in (
            *(f"attn/{name}/{kind}" for name in ("query", "key", "value", "proj") for kind in ("kernel", "bias")),
            *(f"{name}/{kind}" for name in ("ln1", "ln2") for kind in ("scale", "bias")),
            *(f"{name}/{kind}" for name in ("up", "down") for kind in ("kernel", "bias")),
        )
    }
    ends = {"token_embedding/embedding", "position_embedding", "final_norm/scale", "final_norm/bias"}
    assert found == blocks | ends | {"projection/kernel"}


def _leaves(tree):
    return jax.tree_util.tree_flatten_with_path(tree)[0]


@pytest.mark.parametrize("config", [CONFIG, LEGACY], ids=["end_token", "largest"])
@pytest.mark.parametrize("filling", [0, 5, 17])
def test_what_stands_behind_the_end_has_no_influence(config, filling, variables):
    filled = TOKENS.copy()
    filled[0, 4:] = filling
    np.testing.assert_array_equal(embed(config, variables, filled), embed(config, variables, TOKENS))


@pytest.mark.parametrize("config", [CONFIG, LEGACY], ids=["end_token", "largest"])
def test_every_token_before_the_end_has_influence(config, variables):
    wanted = embed(config, variables, TOKENS)[1]
    for position in range(TOKENS.shape[1] - 1):
        changed = TOKENS.copy()
        changed[1, position] = 11
        assert np.abs(embed(config, variables, changed)[1] - wanted).max() > 1e-3


def test_a_narrower_batch_gives_the_same(variables):
    np.testing.assert_allclose(
        embed(CONFIG, variables, TOKENS[:1, :4]), embed(CONFIG, variables, TOKENS)[:1], rtol=0, atol=1e-5
    )


def test_the_embedding_is_not_normalised(variables):
    doubled = jax.tree_util.tree_map_with_path(
        lambda path, leaf: 2 * leaf if "projection" in jax.tree_util.keystr(path) else leaf, variables
    )
    np.testing.assert_allclose(embed(CONFIG, doubled, TOKENS), 2 * embed(CONFIG, variables, TOKENS), rtol=1e-6)


def test_a_token_behind_the_end_in_the_vocabulary_needs_end_token(variables):
    added = TOKENS.copy()
    added[1, 1] = 19
    spoilt = added.copy()
    spoilt[1, 2:8] = 3
    assert np.abs(embed(CONFIG, variables, added)[1] - embed(CONFIG, variables, spoilt)[1]).max() > 1e-3
    # The original's rule stops at the added token, whatever the caption goes on to say.
    np.testing.assert_array_equal(embed(LEGACY, variables, added)[1], embed(LEGACY, variables, spoilt)[1])


def test_quick_gelu_is_close_to_gelu():
    values = jnp.linspace(-4, 4, 33)
    exact = [0.5 * x * (1 + math.erf(x / math.sqrt(2))) for x in values.tolist()]
    found = quick_gelu(values)
    np.testing.assert_allclose(found, exact, atol=0.021)
    np.testing.assert_allclose(found, [x / (1 + math.exp(-1.702 * x)) for x in values.tolist()], rtol=1e-5, atol=1e-7)


def test_too_many_tokens_are_refused(variables):
    with pytest.raises(ValueError, match="10 tokens do not fit a max_length of 9"):
        embed(CONFIG, variables, np.zeros((1, 10), np.int32))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_heads": 3}, "num_heads: 3 does not divide"),
        ({"max_length": 1}, "max_length: 1 leaves no room"),
        ({"mlp_dim": 0}, "mlp_dim: 0"),
        ({"end_token": 49408}, "end_token: 49408"),
        ({"end_token": -1}, "end_token: -1"),
    ],
)
def test_sizes_that_describe_nothing_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        ClipTextConfig(**changes)


def test_the_first_token_may_be_the_end():
    assert ClipTextConfig(end_token=0).end_token == 0
