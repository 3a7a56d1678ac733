"""Stop rules: where motions end, and that the sampling loop follows them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.sampling import Greedy, StopAtEnd, StopAtHighest, StopAtRandom, StopAtThreshold
from t2m_jax.sampling.loop import CHUNK, GeneratorFunctions, Sampling, sample_codes
from t2m_jax.sampling.stopping import StopRule, make_stop_rule

ROWS = 3 * CHUNK
NEVER = -np.inf


def with_scores(**scores):
    """Returns one motion whose rows have low scores, except for some given as `row5=2.0`."""
    found = np.full(ROWS, -9.0, np.float32)
    for name, score in scores.items():
        found[int(name.removeprefix("row"))] = score
    return found


SCORES = np.stack(
    [
        with_scores(row5=1.0),
        with_scores(row5=1.0, row7=3.0),
        with_scores(row0=1.0, row20=2.0),
        with_scores(),
        with_scores(row3=0.6, row9=0.6),
        with_scores(row23=1.0),
    ]
)


def scripted(scores):
    """A generator whose codes count the rows of each motion, and whose stop scores are given as the text."""

    def begin(text, guidance_scale):
        return jnp.zeros(len(text), jnp.int32), (text, jnp.array(0))

    def draw(context, keys, strategy, *, may_stop):
        return jnp.stack([context, 100 + context], axis=1)

    def step(cache, rows):
        text, row = cache
        score = jax.lax.dynamic_index_in_dim(text, jnp.minimum(row, ROWS - 1), axis=1, keepdims=False)
        return rows[:, 0] + 1, score, (text, row + 1)

    return GeneratorFunctions(begin, draw, step)


def sample(rule, scores=SCORES, **limits):
    sampling = Sampling(Greedy(), rule, **({"max_codes": ROWS} | limits))
    keys = jax.random.split(jax.random.key(0), len(scores))
    return sample_codes(scripted(scores), jnp.asarray(scores), keys, sampling=sampling)


@pytest.mark.parametrize(
    ("rule", "expected"),
    [
        (StopAtEnd(), [5, 5, 0, 24, 3, 23]),
        (StopAtThreshold(), [6, 6, 1, 24, 4, 24]),
        (StopAtThreshold(threshold=0.9), [24, 8, 24, 24, 24, 24]),
        (StopAtHighest(), [6, 8, 21, 1, 4, 24]),
    ],
)
def test_the_loop_ends_motions_by_the_rule(rule, expected):
    sampled = sample(rule)
    np.testing.assert_array_equal(sampled.code_lengths, expected)
    np.testing.assert_array_equal(rule.count(jnp.asarray(SCORES)), expected)
    for codes, length in zip(np.asarray(sampled.codes), expected, strict=True):
        np.testing.assert_array_equal(codes[:length, 0], np.arange(length))
        np.testing.assert_array_equal(codes[:length, 1], 100 + np.arange(length))
        assert not codes[length:].any()


@pytest.mark.slow
def test_motions_end_after_each_row_with_its_probability():
    """With a probability of 0.2 for every row, lengths are those of a geometric distribution, cut at the limit."""
    scores = np.full((4000, ROWS), np.log(0.2 / 0.8), np.float32)
    lengths = np.asarray(sample(StopAtRandom(), scores).code_lengths)
    for row in (1, 2, 5, 10, ROWS):
        np.testing.assert_allclose(np.mean(lengths >= row), 0.8 ** (row - 1), atol=0.03)
    later = np.asarray(sample(StopAtRandom(), scores, min_codes=6).code_lengths)
    np.testing.assert_array_equal(later[lengths >= 6], lengths[lengths >= 6])
    assert later.min() == 6


@pytest.mark.slow
def test_a_random_end_depends_on_the_key_of_its_motion_only():
    scores = np.full((6, ROWS), -1.5, np.float32)
    together = sample(StopAtRandom(), scores)
    keys = jax.random.split(jax.random.key(0), 6)
    sampling = Sampling(Greedy(), StopAtRandom(), ROWS)
    for row in range(6):
        one = jnp.asarray(scores[:1])
        alone = sample_codes(scripted(one), one, keys[row : row + 1], sampling=sampling)
        assert alone.code_lengths[0] == together.code_lengths[row]
    assert len(set(np.asarray(together.code_lengths).tolist())) > 2


@pytest.mark.parametrize(
    ("name", "kind"),
    [("end", StopAtEnd), ("threshold", StopAtThreshold), ("argmax", StopAtHighest), ("sampled", StopAtRandom)],
)
def test_rules_are_found_by_name(name, kind):
    rule = make_stop_rule(name)
    assert isinstance(rule, StopRule) and type(rule) is kind
    assert hash(rule) == hash(make_stop_rule(name))


def test_an_unknown_rule_is_named():
    with pytest.raises(UserError, match="stop_rule: 'soon' is unknown; known: end, threshold, argmax, sampled"):
        make_stop_rule("soon")


@pytest.mark.parametrize(("rule", "steps"), [(StopAtEnd(), 8), (StopAtThreshold(), 8), (StopAtHighest(), ROWS)])
def test_a_batch_takes_as_long_as_its_rule_allows(rule, steps):
    assert sample(rule, SCORES[:1]).steps == steps
    assert rule.ends_early == (steps < ROWS)


@pytest.mark.parametrize("rule", [StopAtEnd(), StopAtThreshold(), StopAtHighest()])
def test_shortest_and_longest_length_are_kept(rule):
    lengths = np.asarray(sample(rule, min_codes=7, max_codes=10).code_lengths)
    assert lengths.min() >= 7 and lengths.max() <= 10
    free = np.asarray(sample(rule, max_codes=10).code_lengths)
    inside = (free >= 7) & (free <= 10)
    np.testing.assert_array_equal(lengths[inside], free[inside])


@pytest.mark.parametrize("rule", [StopAtEnd(), StopAtThreshold()])
def test_rows_that_were_not_sampled_do_not_count(rule):
    cut = SCORES.copy()
    cut[:, 16:] = NEVER
    ended = np.asarray(rule.count(jnp.asarray(SCORES))) <= 16
    np.testing.assert_array_equal(
        np.asarray(rule.count(jnp.asarray(cut)))[ended], rule.count(jnp.asarray(SCORES))[ended]
    )
