"""Laws of the double-tier GPT: what a prediction may depend on, guidance, and what is computed in bfloat16."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.models.hifigpt import HiFiGpt, HiFiGptConfig
from t2m_jax.models.rows import in_precision
from t2m_jax.models.system import variable_shapes
from t2m_jax.sampling.loop import Sampling
from t2m_jax.sampling.programs import generate_codes
from t2m_jax.sampling.stopping import StopAtHighest
from t2m_jax.sampling.strategies import Greedy, Temperature, TopK, TopP
from tests.jit import compiled_apply
from tests.tiny import HIFIGPT, random_variables

CONFIGS = {
    "default": HIFIGPT,
    "per_depth": dataclasses.replace(HIFIGPT, head="per_depth"),
    "cumulative": dataclasses.replace(HIFIGPT, cumulative_depth=True),
    "learned": dataclasses.replace(HIFIGPT, code_embedding="learned"),
    "one_depth": dataclasses.replace(HIFIGPT, num_quantizers=1),
}
VARIANTS = ["default", *(pytest.param(name, marks=pytest.mark.slow) for name in CONFIGS if name != "default")]
TEXT = jax.random.normal(jax.random.key(0), (3, HIFIGPT.text_dim))
KEYS = jax.random.split(jax.random.key(1), 3)


def make(config):
    variables = jax.device_put(random_variables(variable_shapes(config), gain=1.5))
    return HiFiGpt(config), variables


def draw_codes(config, rows=6, seed=2):
    return jax.random.randint(jax.random.key(seed), (3, rows, config.num_quantizers), 0, config.num_codes)


@pytest.mark.parametrize("name", VARIANTS)
def test_a_prediction_sees_earlier_codes_only(name):
    """Codes of row t and depth w change neither earlier rows, nor depths up to w of the row, nor earlier stops."""
    config = CONFIGS[name]
    module, variables = make(config)
    codes = draw_codes(config)
    predict = jax.jit(lambda codes: module.apply(variables, codes, TEXT, train=False))
    before = predict(codes)
    for row, depth in ((0, 0), (2, config.num_quantizers - 1), (5, 0)):
        after = predict(codes.at[:, row, depth].add(1) % config.num_codes)
        changed = np.asarray(jnp.any(before.code_logits != after.code_logits, axis=(0, 3)))
        assert not changed[:row].any()
        assert not changed[row, : depth + 1].any()
        assert changed[row, depth + 1 :].all() and changed[row + 1 :].all()
        stops = np.asarray(jnp.any(before.stop_logits != after.stop_logits, axis=0))
        assert not stops[:row].any() and stops[row:].all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "scale"),
    [
        *(("default", 2.5), ("per_depth", 2.5), ("learned", 2.5)),
        *(("default", None), ("cumulative", None), ("one_depth", None)),
        *(pytest.param(name, 2.5, marks=pytest.mark.release) for name in ("cumulative", "one_depth")),
        *(pytest.param(name, None, marks=pytest.mark.release) for name in ("per_depth", "learned")),
    ],
)
def test_sampled_rows_are_those_of_the_whole_sequence(name, scale):
    """Greedy codes, read with a cache, are the likeliest under teacher forcing; so are the stops."""
    config = CONFIGS[name]
    module, variables = make(config)
    sampling = Sampling(Greedy(), StopAtHighest(), config.max_codes)
    given = None if scale is None else jnp.float32(scale)
    sampled = generate_codes(variables, TEXT, KEYS, given, generator=module, sampling=sampling)
    with_text = compiled_apply(module, variables, sampled.codes, TEXT, train=False)
    logits, stops = with_text.code_logits, with_text.stop_logits
    if scale is not None:
        without = compiled_apply(module, variables, sampled.codes, jnp.zeros_like(TEXT), train=False)
        logits = without.code_logits + scale * (logits - without.code_logits)
        stops = without.stop_logits + scale * (stops - without.stop_logits)
    for row, length in enumerate(sampled.code_lengths):
        np.testing.assert_array_equal(jnp.argmax(logits[row, :length], axis=-1), sampled.codes[row, :length])
        assert jnp.argmax(stops[row, :length]) + 1 == length


@pytest.mark.slow
def test_a_guidance_of_one_is_no_guidance():
    module, variables = make(HIFIGPT)
    sampling = Sampling(Temperature(), StopAtHighest(), HIFIGPT.max_codes)
    options = {"generator": module, "sampling": sampling}
    plain = generate_codes(variables, TEXT, KEYS, None, **options)
    guided = generate_codes(variables, TEXT, KEYS, jnp.float32(1.0), **options)
    np.testing.assert_array_equal(plain.codes, guided.codes)
    np.testing.assert_array_equal(plain.code_lengths, guided.code_lengths)
    strong = generate_codes(variables, TEXT, KEYS, jnp.float32(6.0), **options)
    assert strong.codes.shape == plain.codes.shape and (strong.codes != plain.codes).any()


@pytest.mark.slow
@pytest.mark.parametrize(
    "strategy",
    [Temperature(), *(pytest.param(one, marks=pytest.mark.release) for one in (TopK(k=3), TopP(p=0.8)))],
    ids=["temperature", "top-k", "top-p"],
)
def test_a_motion_depends_on_its_text_and_key_only(strategy):
    module, variables = make(HIFIGPT)
    options = {"generator": module, "sampling": Sampling(strategy, StopAtHighest(), HIFIGPT.max_codes)}
    scale = jnp.float32(2.0)
    together = generate_codes(variables, TEXT, KEYS, scale, **options)
    assert len(np.unique(np.asarray(together.codes).reshape(3, -1), axis=0)) == 3
    for rows in ([1], [2, 0, 1]):
        chosen = jnp.array(rows)
        alone = generate_codes(variables, TEXT[chosen], KEYS[chosen], scale, **options)
        np.testing.assert_array_equal(alone.codes, together.codes[chosen])


@pytest.mark.slow
def test_every_code_has_a_key_of_its_own():
    """With a strategy that looks at the key alone, codes would repeat if keys did."""
    module, variables = make(HIFIGPT)

    def draw(logits, key):
        return jax.random.randint(key, logits.shape[:1], 0, 2**30)

    options = {"generator": module, "sampling": Sampling(draw, StopAtHighest(), HIFIGPT.max_codes)}
    sampled = generate_codes(variables, TEXT, KEYS, jnp.float32(2.0), **options)
    for row, length in enumerate(sampled.code_lengths):
        drawn = np.asarray(sampled.codes[row, :length])
        assert len(np.unique(drawn)) == drawn.size


@pytest.mark.slow
@pytest.mark.parametrize("cumulative", [pytest.param(False, marks=pytest.mark.release), True])
def test_noise_in_place_of_keys_draws_the_same_rows(cumulative):
    """Programs without generators of random numbers get the noise that the keys would give."""
    module, variables = make(dataclasses.replace(HIFIGPT, cumulative_depth=cumulative))
    keys = jax.random.split(jax.random.key(4), 5)

    def gumbel(key):
        return jax.random.gumbel(key, (1, HIFIGPT.num_codes))[0]

    noise = jax.vmap(lambda key: jax.vmap(gumbel)(jax.random.split(key, HIFIGPT.num_quantizers)))(keys)
    texts = jax.random.normal(jax.random.key(5), (5, HIFIGPT.text_dim))
    context, _ = compiled_apply(module, variables, texts, jnp.array(2.0), method="begin")

    def add_noise(logits, noise):
        return jnp.argmax(logits + noise[None], axis=-1)

    draw = functools.partial(module.apply, variables, context, method="draw", may_stop=jnp.array(True))
    draw = jax.jit(draw, static_argnums=1)
    np.testing.assert_array_equal(draw(noise, add_noise), draw(keys, Temperature()))
    assert (draw(0 * noise, add_noise) != draw(noise, add_noise)).any()


@pytest.mark.slow
def test_products_are_in_bfloat16_and_scores_finite():
    module, variables = make(HIFIGPT)
    codes, text = draw_codes(HIFIGPT), TEXT.astype(jnp.bfloat16)
    low = in_precision(variables, "bfloat16")
    output = compiled_apply(module, low, codes, text, train=False)
    assert output.code_logits.dtype == output.stop_logits.dtype == jnp.bfloat16
    exact = compiled_apply(module, variables, codes, TEXT, train=False)
    error = np.abs(np.asarray(output.code_logits, np.float32) - exact.code_logits)
    assert error.max() < 0.1 * np.abs(exact.code_logits).max()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_heads": 3}, "num_heads: 3 does not divide"),
        ({"code_embedding": "frozen", "code_dim": 4}, "code_embedding: frozen needs code_dim 4"),
        ({"stop_threshold": 0.0}, "stop_threshold: 0.0"),
        ({"max_codes": 0}, "max_codes"),
    ],
)
def test_impossible_sizes_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        HiFiGptConfig(**options)


def test_too_many_rows_are_refused():
    module, variables = make(HIFIGPT)
    with pytest.raises(ValueError, match="21 rows are more than max_codes 20"):
        module.apply(variables, draw_codes(HIFIGPT, rows=21), TEXT, train=False)
