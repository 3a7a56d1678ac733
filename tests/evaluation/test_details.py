"""Details of a repeat: the same motions as in the table's first repeat, ranked and counted in the same way."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.synthetic import write_synthetic_dataset
from t2m_jax.evaluation.protocols import find_protocol
from t2m_jax.evaluation.report.gallery import (
    NUM_EXAMPLES,
    NUM_FAILURES,
    RankedRepeat,
    gather_details,
    rank_repeat,
)
from t2m_jax.evaluation.run import evaluate
from t2m_jax.evaluation.sources import MotionCodes, Reconstruction, make_generation
from t2m_jax.evaluation.task import EvaluationTask, load_samples
from t2m_jax.metrics.retrieval import r_precision
from t2m_jax.sampling import TextToMotion
from tests.tiny import random_bundle, random_evaluator

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    folder = tmp_path_factory.mktemp("details") / "data"
    write_synthetic_dataset(folder, num_clips=44, seed=3)
    samples = load_samples(open_dataset(folder), "train")
    protocol = dataclasses.replace(find_protocol("t2m-gpt"), multimodality_captions=2)
    return EvaluationTask(random_evaluator(), samples, protocol, 120, 3)


@pytest.fixture(scope="module")
def source(task):
    return make_generation(TextToMotion(random_bundle()), task.samples.clips)


@pytest.fixture(scope="module")
def details(task, source):
    return gather_details(task, source)


def few(task, count):
    return task.samples._replace(clips=task.samples.clips[:count], labels=None)


def batches_of(ranked):
    """Returns motions that are ranked together, in batches of 32; the last is filled with the first motions."""
    count = len(ranked.text)
    return np.resize(np.arange(count), -(-count // 32) * 32).reshape(-1, 32)


def ranks_by_hand(ranked, *, slack):
    """Returns how many motions of its batch are no farther from each caption than its own motion and `slack`."""
    batches = batches_of(ranked)
    distances = np.linalg.norm(ranked.text[batches][:, :, None] - ranked.measured[batches][:, None], axis=-1)
    own = np.diagonal(distances, axis1=1, axis2=2)[:, :, None]
    return np.sum(distances <= own + slack, axis=-1).reshape(-1)[: len(ranked.text)]


def check_against_table(task, source, found):
    metrics = evaluate(task, source, num_repeats=1).measured
    ranked = rank_repeat(task, source)
    rows = batches_of(ranked).reshape(-1)
    counted = jnp.arange(len(rows)) < len(ranked.text)
    precision = r_precision(jnp.asarray(ranked.text[rows]), jnp.asarray(ranked.measured[rows]), counted=counted)
    for k in (1, 2, 3):
        assert precision[k - 1] == pytest.approx(metrics[f"r_precision_{k}"].mean, abs=1e-6)
        # An untrained model makes some motions twice; such equals come first in the rank that is shown.
        assert np.mean(found.ranks <= k) <= metrics[f"r_precision_{k}"].mean + 1e-6
    # Of motions made alike either may be farther by the last bit.
    least, most = (ranks_by_hand(ranked, slack=slack) for slack in (-1e-5, 1e-5))
    assert np.all(found.ranks > least) and np.all(found.ranks <= most)
    assert ranked.distances.mean() == pytest.approx(metrics["matching_score"].mean, rel=1e-5)


@pytest.mark.release
def test_the_motions_are_those_of_the_first_repeat(task, source, details):
    check_against_table(task, source, details)


@pytest.mark.release
def test_the_motions_are_the_same_if_the_last_sample_counts_and_a_batch_is_not_full(task, source):
    protocol = dataclasses.replace(
        find_protocol("strict"), generated_length="real", first_counts=False, multimodality_captions=2
    )
    judged = task._replace(protocol=protocol, samples=few(task, 15))
    found = gather_details(judged, source)
    assert len(found.ranks) % 32, "every batch is full"
    check_against_table(judged, source, found)
    np.testing.assert_array_equal(found.measured_lengths, found.real_lengths)


def test_it_has_one_value_a_motion_and_a_count_a_code(details):
    count = len(details.ranks)
    assert count and count % 32 == 0
    assert all(len(column) == count for column in (details.real_lengths, details.measured_lengths))
    assert details.ranks.min() >= 1 and details.ranks.max() <= 32
    assert details.real_lengths.max() <= 120 and details.measured_lengths.max() <= 120
    assert len(details.real_code_counts) == len(details.measured_code_counts) == 16
    assert details.measured_code_counts.sum() >= details.measured_lengths.sum() // 4
    assert details.real_code_counts.sum() == details.real_lengths.sum() // 4, "no real motion is cut here"
    assert (details.real_code_counts != details.measured_code_counts).any()


def test_real_codes_are_those_of_each_piece_alone(task, source, details):
    tokenizer = source.tokenizer
    encode = jax.jit(lambda motion: tokenizer.module.apply(tokenizer.variables, motion, method="encode"))
    clips = [clip for clip in task.samples.clips if len(clip.features) >= 40][:3]
    # Whole pieces of one length, so that one program is compiled.
    cut = [clip._replace(features=clip.features[:40], captions=clip.captions[:1]) for clip in clips]
    judged = task._replace(samples=task.samples._replace(clips=cut * 11, labels=None), protocol=find_protocol("strict"))
    expected = sum(
        np.bincount(
            np.asarray(encode(np.asarray(tokenizer.normalizer.normalize(clip.features))[None])[0, :, 0]), minlength=16
        )
        for clip in cut
    )
    found = gather_details(judged, Reconstruction(tokenizer))
    np.testing.assert_array_equal(found.real_code_counts, 11 * expected)
    np.testing.assert_array_equal(found.measured_code_counts, 11 * expected)
    assert (expected > 0).sum() > 1, "one code says nothing"
    assert found.kind == "reconstruction" and details.kind == "generated"


def test_examples_have_captions_of_their_own(task, source, details):
    assert len({example.caption for example in details.examples}) == NUM_EXAMPLES
    ranked = rank_repeat(task, source)
    for example in details.examples:
        place = int(np.argmin(np.abs(ranked.distances - example.distance)))
        assert (ranked.captions[place], ranked.ranks[place]) == (example.caption, example.rank)
        assert example.real_distance == pytest.approx(np.linalg.norm(ranked.text[place] - ranked.real[place]))


def test_failures_are_the_worst_of_all_with_captions_of_their_own(details):
    failures = details.failures
    assert len({failure.caption for failure in failures}) == len(failures) == NUM_FAILURES
    assert failures[0].rank == details.ranks.max()
    order = [(-failure.rank, -failure.distance) for failure in failures]
    assert order == sorted(order)
    for failure in failures:
        assert {len(failure.measured), len(failure.real)} <= set(range(4, 121, 4))


def test_among_equals_the_farthest_fails_most(task, source):
    count = 8
    generator = np.random.default_rng(0)
    text, motion = (generator.normal(size=(count, 3)).astype(np.float32) for _ in range(2))
    codes = MotionCodes(np.zeros((count, 4, 1), np.int32), np.full(count, 4, np.int32))
    pieces = [task.samples.clips[0].features[:16]] * count
    captions = [f"caption {number // 2}" for number in range(count)]
    ranks = np.full(count, 2)
    ranked = RankedRepeat(source.tokenizer, 12, captions, pieces, text, text, motion, codes, codes, ranks)
    failures = ranked.show(np.lexsort((-ranked.distances, -ranked.ranks)), count)
    farthest = [captions[row] for row in np.argsort(-ranked.distances)]
    assert [failure.caption for failure in failures] == list(dict.fromkeys(farthest))
    assert all(failure.real_distance == 0 and len(failure.measured) == 12 for failure in failures)


def test_the_seed_chooses_the_examples(task, source, details):
    def captions(found):
        return [example.caption for example in found.examples]

    assert captions(gather_details(task, source)) == captions(details)
    assert captions(gather_details(task._replace(seed=4), source)) != captions(details)
