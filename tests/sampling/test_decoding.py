"""The decoding loop: golden greedy sequences, cached against uncached, independence of the batch."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints.official import gpt_variables
from t2m_jax.models.motion_gpt import MotionGpt, MotionGptConfig
from t2m_jax.sampling.decoding import CHUNK, decode_codes
from t2m_jax.sampling.strategies import Greedy, Temperature, TopK
from tests.golden_files import state_dict

CONFIG = MotionGptConfig(num_codes=11, embed_dim=16, text_dim=6, num_layers=2, num_heads=2, block_size=20, dropout=0.0)


@pytest.fixture(scope="module")
def model_and_variables():
    model = MotionGpt(CONFIG)
    variables = model.init(jax.random.key(0), jnp.zeros((1, 3), int), jnp.zeros((1, 6)), train=False)
    return model, jax.tree.map(lambda leaf: 8.0 * leaf, variables)


def decode(model, variables, text_embedding, keys, **options):
    return decode_codes(
        lambda text: model.apply(variables, text, method="prefill"),
        lambda tokens, caches, position: model.apply(variables, tokens, caches, position, method="decode_step"),
        text_embedding,
        keys,
        max_codes=model.config.max_codes,
        **options,
    )


def decode_without_cache(model, variables, text_embedding, key, strategy):
    """The slow loop of the original: the whole sequence again for every code, one motion at a time."""
    codes = []
    for step in range(model.config.max_codes):
        tokens = jnp.array(codes, int)[None]
        logits = model.apply(variables, tokens, text_embedding[None], train=False)[:, -1]
        token = int(strategy(logits, jax.random.fold_in(key, step))[0])
        if token == model.config.end_token:
            break
        codes.append(token)
    return codes


@pytest.mark.parametrize("name", ["gpt_l2", "gpt_l3"])
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
    variables = gpt_variables(state_dict(arrays), num_layers=config.num_layers)
    texts = jnp.asarray(arrays["greedy_clip_feat"])
    decoded = decode(MotionGpt(config), variables, texts, jax.random.split(jax.random.key(0), 6), strategy=Greedy())
    np.testing.assert_array_equal(decoded.code_lengths, arrays["greedy_length"])
    for row, length in enumerate(arrays["greedy_length"]):
        np.testing.assert_array_equal(decoded.codes[row, :length], arrays["greedy_tokens"][row, :length])


@pytest.mark.parametrize("strategy", [Greedy(), Temperature(), TopK(k=3)])
def test_cached_equals_uncached(model_and_variables, strategy):
    model, variables = model_and_variables
    texts, keys = jax.random.normal(jax.random.key(1), (6, 6)), jax.random.split(jax.random.key(2), 6)
    decoded = decode(model, variables, texts, keys, strategy=strategy)
    assert len(set(decoded.code_lengths.tolist())) > 1, "the test wants motions of several lengths"
    for row in range(6):
        expected = decode_without_cache(model, variables, texts[row], keys[row], strategy)
        assert decoded.codes[row, : decoded.code_lengths[row]].tolist() == expected


def test_a_batch_equals_its_members_alone(model_and_variables):
    model, variables = model_and_variables
    texts, keys = jax.random.normal(jax.random.key(3), (8, 6)), jax.random.split(jax.random.key(4), 8)
    together = decode(model, variables, texts, keys, strategy=Temperature())
    for row in range(8):
        alone = decode(model, variables, texts[row : row + 1], keys[row : row + 1], strategy=Temperature())
        np.testing.assert_array_equal(together.codes[row], alone.codes[0])
        assert together.code_lengths[row] == alone.code_lengths[0]


def test_jit_equals_eager(model_and_variables):
    model, variables = model_and_variables
    texts, keys = jax.random.normal(jax.random.key(5), (2, 6)), jax.random.split(jax.random.key(6), 2)
    jitted = jax.jit(lambda texts, keys: decode(model, variables, texts, keys, strategy=Temperature()))(texts, keys)
    with jax.disable_jit():
        eager = decode(model, variables, texts, keys, strategy=Temperature())
    np.testing.assert_array_equal(jitted.codes, eager.codes)


def test_short_motions_cost_few_steps(model_and_variables):
    model, variables = model_and_variables

    def always_end(logits, key):
        del key
        return jnp.full(logits.shape[0], CONFIG.end_token)

    texts, keys = jnp.zeros((3, 6)), jax.random.split(jax.random.key(7), 3)
    decoded = decode(model, variables, texts, keys, strategy=always_end)
    assert decoded.steps == CHUNK
    np.testing.assert_array_equal(decoded.code_lengths, 0)


def test_end_waits_for_min_codes(model_and_variables):
    model, variables = model_and_variables
    loud = jax.tree.map(lambda leaf: leaf, variables)
    loud["params"]["head"]["kernel"] = variables["params"]["head"]["kernel"].at[:, -1].set(0.0)
    loud["params"]["final_norm"]["scale"] = jnp.zeros(16)
    texts, keys = jnp.zeros((2, 6)), jax.random.split(jax.random.key(8), 2)
    decoded = decode(model, loud, texts, keys, strategy=Temperature(), min_codes=CONFIG.max_codes)
    np.testing.assert_array_equal(decoded.code_lengths, CONFIG.max_codes)
