"""The sampling loop: golden greedy sequences, cached against uncached, independence of the batch."""

import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints.official.load import gpt_variables
from t2m_jax.models.motion_gpt import MotionGpt, MotionGptConfig
from t2m_jax.sampling import Greedy, StopAtEnd, TopK
from t2m_jax.sampling.loop import CHUNK, Sampling
from t2m_jax.sampling.programs import generate_codes, sampling_variables
from tests.golden_files import state_dict
from tests.tiny import random_variables

CONFIG = MotionGptConfig(num_codes=11, embed_dim=16, text_dim=6, num_layers=2, num_heads=2, block_size=20, dropout=0.0)
BATCH = 8


@pytest.fixture(scope="module")
def model_and_variables():
    """A model whose weights are large enough that texts end at different places, also greedily."""
    model = MotionGpt(CONFIG)
    tokens, text = jnp.zeros((1, 3), int), jnp.zeros((1, CONFIG.text_dim))
    return model, random_variables(jax.eval_shape(lambda: model.init(jax.random.key(0), tokens, text, train=False)))


def decode(model, variables, text_embedding, keys, *, strategy, max_codes=None, min_codes=0):
    sampling = Sampling(strategy, StopAtEnd(), max_codes or model.config.max_codes, min_codes)
    sampled = generate_codes(variables, text_embedding, keys, generator=model, sampling=sampling)
    return sampled._replace(codes=sampled.codes[:, :, 0])


@functools.partial(jax.jit, static_argnames=("model", "strategy"))
def next_tokens(model, variables, tokens, text_embedding, keys, step, *, strategy):
    """The next token of each sequence from the logits of the whole sequences, as the original makes them."""
    logits = model.apply(variables, tokens, text_embedding, train=False)[:, step]
    return jnp.stack(
        [strategy(row[None], jax.random.fold_in(key, step))[0] for row, key in zip(logits, keys, strict=True)]
    )


def decode_without_cache(model, variables, text_embedding, keys, strategy):
    """The slow loop of the original: the whole sequences again for every code."""
    tokens = np.zeros((len(keys), model.config.max_codes), np.int32)
    for step in range(model.config.max_codes):
        tokens[:, step] = next_tokens(model, variables, tokens, text_embedding, keys, step, strategy=strategy)
        tokens[:, step + 1 :] = 0
    ends = [[*row, model.config.end_token].index(model.config.end_token) for row in tokens.tolist()]
    return [row[:end].tolist() for row, end in zip(tokens, ends, strict=True)]


def texts_and_keys(seed, batch=BATCH):
    text_key, sample_key = jax.random.split(jax.random.key(seed))
    return jax.random.normal(text_key, (batch, CONFIG.text_dim)), jax.random.split(sample_key, batch)


@pytest.mark.parametrize("name", ["gpt_l2", pytest.param("gpt_l3", marks=pytest.mark.slow)])
def test_golden_greedy_sequences(golden_dir, name):
    arrays = np.load(golden_dir / "t2m_gpt" / f"{name}.npz")
    sizes = json.loads(str(arrays["config_json"]))
    config = MotionGptConfig(
        num_codes=sizes["nb_code"],
        embed_dim=sizes["embed_dim"],
        text_dim=sizes["clip_dim"],
        num_layers=2 * sizes["num_layers"],
        num_heads=sizes["n_head"],
        block_size=sizes["block_size"],
    )
    variables = gpt_variables(state_dict(arrays), config)
    texts = jnp.asarray(arrays["greedy_clip_feat"])
    decoded = decode(MotionGpt(config), variables, texts, jax.random.split(jax.random.key(0), 6), strategy=Greedy())
    np.testing.assert_array_equal(decoded.code_lengths, arrays["greedy_length"])
    for row, length in enumerate(arrays["greedy_length"]):
        np.testing.assert_array_equal(decoded.codes[row, :length], arrays["greedy_tokens"][row, :length])


@pytest.mark.parametrize("strategy", [pytest.param(Greedy(), marks=pytest.mark.slow), TopK(k=3)])
def test_cached_equals_uncached(model_and_variables, strategy):
    model, variables = model_and_variables
    texts, keys = texts_and_keys(1)
    decoded = decode(model, variables, texts, keys, strategy=strategy)
    lengths = decoded.code_lengths.tolist()
    assert len(set(lengths)) > 2 and min(lengths) < CONFIG.max_codes, "the test wants motions of several lengths"
    found = [codes[:length].tolist() for codes, length in zip(decoded.codes, lengths, strict=True)]
    assert found == decode_without_cache(model, variables, texts, keys, strategy)


def test_past_its_end_a_sequence_is_zero(model_and_variables):
    texts, keys = texts_and_keys(1)
    decoded = decode(*model_and_variables, texts, keys, strategy=Greedy())
    past = np.arange(CONFIG.max_codes)[None] >= np.asarray(decoded.code_lengths)[:, None]
    assert past.any()
    np.testing.assert_array_equal(np.asarray(decoded.codes)[past], 0)


@pytest.mark.slow
def test_a_batch_equals_its_members_alone(model_and_variables):
    texts, keys = texts_and_keys(3)
    together = decode(*model_and_variables, texts, keys, strategy=TopK(k=3))
    for row in range(BATCH):
        alone = decode(*model_and_variables, texts[row : row + 1], keys[row : row + 1], strategy=TopK(k=3))
        np.testing.assert_array_equal(together.codes[row], alone.codes[0])
        assert together.code_lengths[row] == alone.code_lengths[0]


def test_short_motions_cost_few_steps(model_and_variables):
    def always_end(logits, key):
        del key
        return jnp.full(logits.shape[0], CONFIG.end_token)

    texts, keys = texts_and_keys(7)
    decoded = decode(*model_and_variables, texts, keys, strategy=always_end)
    assert decoded.steps == CHUNK
    np.testing.assert_array_equal(decoded.code_lengths, 0)


def test_end_waits_for_min_codes(model_and_variables):
    texts, keys = texts_and_keys(1)
    free = decode(*model_and_variables, texts, keys, strategy=Greedy())
    held = decode(*model_and_variables, texts, keys, strategy=Greedy(), min_codes=6)
    assert np.min(free.code_lengths) < 6 <= np.min(held.code_lengths)
    late = np.asarray(free.code_lengths) >= 6
    assert late.any()
    np.testing.assert_array_equal(free.codes[late], held.codes[late])


@pytest.mark.slow
@pytest.mark.parametrize("strategy", [Greedy(), TopK(k=3)])
def test_the_layout_of_the_weights_does_not_matter(model_and_variables, strategy):
    model, variables = model_and_variables
    fast = sampling_variables(variables, CONFIG)
    assert "transposed" in fast, "the test wants two layouts"
    texts, keys = texts_and_keys(1)
    expected = decode(model, variables, texts, keys, strategy=strategy)
    for found, wanted in zip(decode(model, fast, texts, keys, strategy=strategy), expected, strict=True):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.slow
@pytest.mark.parametrize("batch", [1, 8, 32])
def test_logits_do_not_depend_on_the_other_rows_in_any_bit(model_and_variables, batch):
    model, variables = model_and_variables
    begin = jax.jit(functools.partial(model.apply, sampling_variables(variables, CONFIG), method="begin"))
    texts, _ = texts_and_keys(5, batch)
    others, _ = texts_and_keys(6, batch)
    expected, _ = begin(texts)
    for row in {0, batch // 2, batch - 1}:
        found, _ = begin(others.at[row].set(texts[row]))
        np.testing.assert_array_equal(found[row], expected[row])
