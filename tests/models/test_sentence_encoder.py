"""The network of sentence encoders: what has no influence on an embedding, and distances between tokens."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.models.sentence_encoder import SentenceEncoder, SentenceEncoderConfig, distance_buckets
from tests.tiny import random_variables

SIZES = {"vocabulary_size": 30, "max_length": 12, "num_positions": 16, "embed_dim": 16, "num_layers": 2, "num_heads": 2}
KINDS = {
    "mean": {},
    "cls": {"pooling": "cls", "first_position": 2, "num_types": 1},
    "normalized": {"normalize": True},
    "distances": {"num_buckets": 8, "num_types": 0},
}


@pytest.fixture(params=KINDS)
def embed(request):
    """Returns a function from tokens and mask to embeddings, for each kind of encoder."""
    config = SentenceEncoderConfig(**SIZES, **KINDS[request.param], mlp_dim=24)
    module, tokens = SentenceEncoder(config), jnp.zeros((1, 4), jnp.int32)
    shapes = jax.eval_shape(module.init, jax.random.key(0), tokens, tokens == 0)
    variables = random_variables(shapes)
    return lambda tokens, mask: np.asarray(module.apply(variables, jnp.asarray(tokens), jnp.asarray(mask)))


@pytest.fixture
def batch():
    """Returns tokens and masks of three captions."""
    tokens = np.random.default_rng(1).integers(0, 30, (3, 9)).astype(np.int32)
    return tokens, np.arange(9) < np.array([[9], [4], [1]])


@pytest.mark.slow
def test_padding_does_not_change_an_embedding(embed, batch):
    tokens, mask = batch
    wanted = embed(tokens, mask)
    np.testing.assert_allclose(embed(np.where(mask, tokens, 29 - tokens), mask), wanted, rtol=0, atol=1e-6)
    wider = embed(np.pad(tokens, ((0, 0), (0, 3)), constant_values=7), np.pad(mask, ((0, 0), (0, 3))))
    np.testing.assert_allclose(wider, wanted, rtol=0, atol=1e-5)
    assert np.abs(embed(29 - tokens, mask) - wanted).max() > 1e-2


@pytest.mark.slow
def test_an_embedding_does_not_depend_on_its_neighbors(embed, batch):
    tokens, mask = batch
    alone = [embed(tokens[row : row + 1], mask[row : row + 1])[0] for row in range(3)]
    np.testing.assert_allclose(alone, embed(tokens, mask), rtol=0, atol=1e-5)


@pytest.mark.slow
def test_the_order_of_tokens_matters(embed, batch):
    tokens, mask = batch
    swapped = tokens[:, [0, 2, 1, *range(3, 9)]]
    assert np.abs(embed(swapped, mask)[:2] - embed(tokens, mask)[:2]).min(axis=1).max() > 1e-4


@pytest.mark.slow
def test_embeddings_have_length_1_if_the_config_says_so(batch):
    for normalize in (True, False):
        module = SentenceEncoder(SentenceEncoderConfig(**SIZES, mlp_dim=24, normalize=normalize))
        found, _ = module.init_with_output(jax.random.key(0), *map(jnp.asarray, batch))
        assert np.allclose(np.linalg.norm(found, axis=1), 1, atol=1e-5) == normalize


def test_distances_have_the_classes_of_the_paper():
    """With 32 classes: one for each distance up to 8, then two for each doubling, and 16 more for later tokens."""
    found = distance_buckets(200, 32)
    wanted = {0: 0, 1: 1, 7: 7, 8: 8, 11: 8, 12: 9, 15: 9, 16: 10, 31: 11, 32: 12, 64: 14, 128: 15, 199: 15}
    assert {distance: found[distance, 0] for distance in wanted} == wanted
    assert {distance: found[0, distance] for distance in wanted if distance} == {
        distance: bucket + 16 for distance, bucket in wanted.items() if distance
    }
    np.testing.assert_array_equal(found[50:150, 50:150], found[:100, :100])


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"num_heads": 3}, r"num_heads: 3 does not divide embed_dim 16"),
        ({"max_length": 17}, r"max_length: 17 tokens do not fit 16 positions"),
        ({"first_position": 5}, r"max_length: 12 tokens do not fit 16 positions"),
        ({"first_position": -1}, r"first_position: -1"),
        ({"num_buckets": 6}, r"num_buckets: 6 is not a multiple of 4"),
        ({"num_positions": 10**9}, r"num_positions: 1000000000 is more than"),
    ],
)
def test_sizes_that_do_not_fit_are_refused(changes, reason):
    with pytest.raises(ValueError, match=reason):
        SentenceEncoderConfig(**(SIZES | changes))


def test_more_tokens_than_positions_are_refused(embed):
    with pytest.raises(ValueError, match=r"13 tokens do not fit a max_length of 12"):
        embed(np.zeros((1, 13), np.int32), np.ones((1, 13), bool))
