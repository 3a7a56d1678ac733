"""R-precision, matching score, diversity and multimodality: reference numbers and laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.metrics.retrieval import label_bound, matching_score, r_precision, ranks_of_batches
from t2m_jax.metrics.variety import diversity, multimodality
from tests.jit import assert_jit_equals_eager


def load(golden_dir, name):
    return np.load(golden_dir / "evaluation" / f"{name}.npz")


def pairs_of(first, second):
    return jnp.stack([jnp.asarray(first), jnp.asarray(second)], axis=1)


def test_golden_r_precision_both_ways(golden_dir):
    arrays = load(golden_dir, "r_precision")
    text, motion = (jnp.asarray(arrays[name].reshape(-1, arrays[name].shape[-1])) for name in ("text", "motion"))
    np.testing.assert_allclose(r_precision(text, motion), arrays["r_precision"], rtol=1e-6)
    other_way = r_precision(text, motion, direction="texts_per_motion")
    np.testing.assert_allclose(other_way, arrays["counts_motion_to_text"].sum(0) / len(text), rtol=1e-6)
    np.testing.assert_allclose(matching_score(text, motion), arrays["mm_dist"], rtol=5e-6)


def test_golden_diversity_and_multimodality(golden_dir):
    arrays = load(golden_dir, "diversity_multimodality")
    for count in (300, 100):
        pairs = pairs_of(arrays[f"first_{count}"], arrays[f"second_{count}"])
        found = diversity(jnp.asarray(arrays["activations"]), pairs)
        np.testing.assert_allclose(found, arrays[f"diversity_{count}"], rtol=5e-6)
    pairs = pairs_of(arrays["mm_first"], arrays["mm_second"])
    found = multimodality(jnp.asarray(arrays["mm_activations"]), pairs)
    np.testing.assert_allclose(found, arrays["multimodality"], rtol=5e-6)


def embeddings(seed, count=640, width=16):
    return jax.random.normal(jax.random.key(seed), (count, width))


def test_pairs_that_agree_are_found_first():
    text = embeddings(0)
    np.testing.assert_array_equal(r_precision(text, text), 1.0)
    assert matching_score(text, text) == 0.0


def test_shuffled_pairs_are_found_by_chance():
    text = embeddings(0, 32 * 1000)
    motion = text + 0.8 * embeddings(1, 32 * 1000)
    assert r_precision(text, motion)[0] > 0.2
    shuffled = motion[np.random.default_rng(0).permutation(len(motion))]
    chance = np.arange(1, 4) / 32
    deviation = np.sqrt(chance * (1 - chance) / len(text))
    for direction in ("motions_per_text", "texts_per_motion"):
        found = r_precision(text, shuffled, direction=direction)
        assert np.all(np.abs(found - chance) < 4 * deviation), found


def test_swapping_two_captions_costs_those_two():
    text = embeddings(0)
    swapped = text.at[jnp.array([3, 7])].set(text[jnp.array([7, 3])])
    np.testing.assert_allclose(1 - r_precision(swapped, text)[0], 2 / 640, rtol=1e-4)


def test_the_order_of_batches_and_the_frame_of_reference_do_not_matter():
    text = embeddings(0)
    motion = text + 0.8 * embeddings(1)
    expected = r_precision(text, motion)
    assert 0.2 < expected[0] < 0.95
    order = np.random.default_rng(0).permutation(20)
    batches = [rows.reshape(20, 32, -1)[order].reshape(640, -1) for rows in (text, motion)]
    np.testing.assert_allclose(r_precision(*batches), expected)
    np.testing.assert_allclose(r_precision(text + 3.0, motion + 3.0), expected)


def test_candidates_of_the_same_label_are_no_errors():
    text = jnp.repeat(embeddings(0, 16), 2, axis=0)
    motion = text + 0.01 * embeddings(1, 32)
    labels = jnp.repeat(jnp.arange(16), 2)
    assert r_precision(text, motion)[0] < 0.9
    np.testing.assert_array_equal(r_precision(text, motion, labels=labels), 1.0)


def test_candidates_that_fill_up_a_batch_do_not_count():
    text = embeddings(0, 64)
    motion = text.at[40:].set(-text[40:])
    counted = jnp.arange(64) < 40
    found = r_precision(text, motion, counted=counted)
    assert found[0] == 1.0
    assert r_precision(text, motion, counted=~counted)[0] < 0.2


def test_incomplete_batches_are_refused():
    with pytest.raises(ValueError, match="33 texts and 33 motions"):
        r_precision(embeddings(0, 33), embeddings(1, 33))


def test_a_pair_of_one_sample_with_itself_counts_as_no_distance():
    points = jnp.array([[0.0, 0.0], [3.0, 4.0]])
    pairs = jnp.array([[0, 1], [1, 1]])
    assert diversity(points, pairs) == 2.5
    assert multimodality(jnp.stack([points, 2 * points]), pairs) == 3.75


def test_equal_samples_have_no_variety():
    pairs = jnp.stack([jnp.arange(10), jnp.arange(20, 30)], axis=1)
    equal = jnp.repeat(embeddings(0, 8)[:, None], 30, axis=1)
    assert multimodality(equal, pairs) == 0.0
    assert diversity(equal[0], pairs) == 0.0
    one_differs = equal.at[3, 25].add(1.0)
    np.testing.assert_allclose(multimodality(one_differs, pairs), np.sqrt(16) / (8 * 10), rtol=1e-6)


@pytest.mark.slow
def test_jit_equals_eager():
    text, motion = embeddings(0, 64), embeddings(1, 64)
    pairs = jnp.arange(20).reshape(10, 2)
    calls = [
        (r_precision, (text, motion)),
        (matching_score, (text, motion)),
        (diversity, (text, pairs)),
        (multimodality, (text.reshape(2, 32, 16), pairs)),
    ]
    for function, arguments in calls:
        assert_jit_equals_eager(jax.jit(function), *arguments)


def test_labels_alone_reach_their_bound():
    labels = np.random.default_rng(0).integers(0, 12, 32 * 400)
    motion = 50.0 * jax.nn.one_hot(labels, 16) + embeddings(1, len(labels))
    text = 50.0 * jax.nn.one_hot(labels, 16) + embeddings(2, len(labels))
    bound = label_bound(jnp.asarray(labels))
    np.testing.assert_allclose(r_precision(text, motion), bound, atol=0.02)
    assert np.all(np.diff(bound) > 0.1) and bound[0] < 0.5
    np.testing.assert_array_equal(r_precision(text, motion, labels=jnp.asarray(labels)), 1.0)


def test_the_bound_of_labels_by_hand():
    labels = jnp.array([7] * 4 + list(range(100, 128)))
    expected = (28 + 4 * np.array([1 / 4, 2 / 4, 3 / 4])) / 32
    np.testing.assert_allclose(label_bound(labels), expected, rtol=1e-6)
    counted = jnp.arange(32) < 4
    np.testing.assert_allclose(label_bound(labels, counted=counted), [1 / 4, 2 / 4, 3 / 4], rtol=1e-6)
    np.testing.assert_array_equal(label_bound(jnp.arange(64)), 1.0)
    with pytest.raises(ValueError, match="31 labels"):
        label_bound(labels[:31])


def test_one_motion_for_all_texts_is_at_chance():
    text = embeddings(0)
    same = jnp.ones_like(text)
    for direction in ("motions_per_text", "texts_per_motion"):
        np.testing.assert_allclose(r_precision(text, same, direction=direction), np.arange(1, 4) / 32, atol=0.02)
    np.testing.assert_allclose(r_precision(text, same), np.arange(1, 4) / 32, rtol=1e-5)


def test_what_is_not_a_number_is_found_by_nobody():
    """All comparisons with NaN are false, as if it were nearest."""
    text = embeddings(0)
    np.testing.assert_allclose(r_precision(text, text.at[3].set(jnp.nan)), 1 - 1 / len(text), rtol=1e-5)
    np.testing.assert_allclose(r_precision(text.at[3].set(jnp.nan), text), 1 - 1 / len(text), rtol=1e-5)
    np.testing.assert_array_equal(r_precision(text, jnp.full_like(text, jnp.nan)), 0)


def test_equal_captions_share_their_place():
    text = jnp.concatenate([jnp.zeros((4, 16)), 100.0 + 50.0 * embeddings(0, 28)])
    motion = text.at[:4].add(embeddings(1, 4))
    found = r_precision(text, motion, direction="texts_per_motion")
    np.testing.assert_allclose(found, (28 + 4 * np.array([1 / 4, 2 / 4, 3 / 4])) / 32, rtol=1e-6)


def test_batches_are_ranked_by_one_program_in_every_repeat():
    text, motion = (jax.random.normal(jax.random.key(seed), (12, 7)) for seed in (1, 2))
    r_precision(text, motion, batch=6)
    compiled = ranks_of_batches._cache_size()
    r_precision(motion, text, batch=6, direction="texts_per_motion")
    assert ranks_of_batches._cache_size() == compiled > 0
