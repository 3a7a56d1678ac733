"""What a change of data, statistics or computing must change in the figures, and what it must leave to the bit."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints.evaluator import make_trained_evaluator
from t2m_jax.data.banks.captions import all_tokens
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.synthetic import write_synthetic_dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation import embedding, sources
from t2m_jax.evaluation.embedding import embed_plan_captions, embed_plan_motions
from t2m_jax.evaluation.protocols import find_protocol
from t2m_jax.evaluation.report.record import CLEANED
from t2m_jax.evaluation.run import evaluate
from t2m_jax.evaluation.sources import make_generation
from t2m_jax.evaluation.task import EvaluationTask, load_samples, make_task
from t2m_jax.metrics.quality import MotionQuality
from t2m_jax.metrics.retrieval import matching_score, r_precision
from t2m_jax.models.evaluator import evaluator_shapes
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.sampling import Greedy, TextToMotion
from t2m_jax.sampling.request import SamplingOptions
from t2m_jax.text.word_vectors import vocabulary_from_captions
from tests.tiny import EVALUATOR, random_bundle, random_variables

TEXT_METRICS = {"matching_score"} | {
    f"r_precision_{k}{kind}" for k in (1, 2, 3) for kind in ("", "_texts_per_motion", "_by_label")
}
"""What needs captions; the other metrics look at motion alone."""
MAX_FRAMES = 196
PROTOCOL = dataclasses.replace(find_protocol("t2m-gpt"), samples_per_caption=10)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("laws") / "data"
    write_synthetic_dataset(folder, num_clips=24, seed=9)
    return open_dataset(folder)


@pytest.fixture(scope="module")
def task(dataset):
    """One batch of motions with a caption each, so that every pair counts in every repeat."""
    found = load_samples(dataset, "train")
    clips = [clip._replace(captions=clip.captions[:1]) for clip in found.clips[:32]]
    vocabulary = vocabulary_from_captions(all_tokens(clips), min_count=1)
    config = dataclasses.replace(EVALUATOR, num_words=len(vocabulary))
    variables = random_variables(evaluator_shapes(config))
    evaluator = make_trained_evaluator(config, variables, dataset.normalizer, vocabulary)
    return EvaluationTask(evaluator, found._replace(clips=clips, labels=found.labels[:32]), PROTOCOL, MAX_FRAMES, 3)


@pytest.fixture(scope="module")
def model(dataset):
    return TextToMotion(random_bundle()._replace(normalizer=dataset.normalizer))


def figures(task, model, strategy=None):
    """Returns the metrics of the first repeat, by row."""
    source = make_generation(model, task.samples.clips, options=SamplingOptions(strategy=strategy))
    report = evaluate(task, source, num_repeats=1)
    return {kind: {name: found.repeats[0] for name, found in of.items()} for kind, of in report.metrics.items()}


@pytest.fixture(scope="module")
def before(task, model):
    return figures(task, model)


def changed(before, after):
    """Returns the metrics that are not the same to the last bit."""
    assert before.keys() == after.keys()
    return {metric for metric in before if before[metric] != after[metric]}


def pairs(task):
    """Returns the embeddings of the captions and motions of the first repeat, and whose they are."""
    plan = task.plan(repeat=0)
    return embed_plan_captions(task, plan), embed_plan_motions(task, plan), plan.samples


def with_clip(task, number, **fields):
    clips = list(task.samples.clips)
    clips[number] = clips[number]._replace(**fields)
    return with_clips(task, clips)


def with_clips(task, clips):
    return task._replace(samples=task.samples._replace(clips=clips))


@pytest.mark.release
def test_swapping_two_captions_changes_what_needs_captions(task, model, before):
    text, motion, owners = pairs(task)
    distances = np.linalg.norm(text[:, None] - motion[None], axis=-1)
    # One that finds its motion first, and one whose text does not: so the shares of hits cannot stay as they are.
    ranks = np.sum(distances < np.diagonal(distances)[:, None], axis=1)
    assert ranks.min() == 0, "the captions of another seed are needed"
    hit = int(np.argmin(ranks))
    other = int(np.argmax(distances[:, hit]))
    one, two = int(owners[hit]), int(owners[other])
    captions = [task.samples.clips[number].captions for number in (one, two)]
    swapped = with_clip(with_clip(task, one, captions=captions[1]), two, captions=captions[0])
    after = figures(swapped, model)["real"]
    found = changed(before["real"], after)
    assert {"matching_score", "r_precision_1"} <= found <= TEXT_METRICS
    text[[hit, other]] = text[[other, hit]]
    expected = r_precision(jnp.asarray(text), jnp.asarray(motion))
    np.testing.assert_allclose([after[f"r_precision_{k}"] for k in (1, 2, 3)], expected)
    np.testing.assert_allclose(after["matching_score"], matching_score(jnp.asarray(text), jnp.asarray(motion)))


@pytest.mark.release
def test_shifting_a_clip_by_a_frame_changes_what_looks_at_it(task, model, before):
    features = task.samples.clips[5].features
    shifted = with_clip(task, 5, features=np.concatenate([features[1:], features[-1:]]))
    after = figures(shifted, model)
    assert changed(before["real"], after["real"]) >= {"fid", "matching_score", "diversity"}
    compared = {"fid", "fid_normalized"}
    assert changed(before["generated"], after["generated"]) == compared, "only what compares it with real motion"
    (text, motion, owners), (text_after, motion_after, _) = pairs(task), pairs(shifted)
    np.testing.assert_array_equal(text, text_after)
    np.testing.assert_array_equal(np.any(motion != motion_after, axis=1), owners == 5)


def rescaled(normalizer, factor, shift=0.0):
    return Normalizer(normalizer.mean + shift * normalizer.std, normalizer.std * factor)


def with_statistics(task, normalizer):
    evaluator = task.evaluator
    return task._replace(
        evaluator=make_trained_evaluator(evaluator.config, evaluator.variables, normalizer, evaluator.vocabulary)
    )


@pytest.mark.parametrize(("factor", "shift"), [(1.7, 0.0), (0.6, 0.0), (1.0, 0.6), (1.0, -0.6)])
def test_statistics_that_are_far_off_are_refused(task, dataset, factor, shift):
    other = with_statistics(task, rescaled(dataset.normalizer, factor, shift))
    with pytest.raises(UserError, match="differ too much from those of the evaluator"):
        make_task(dataset, other.evaluator, PROTOCOL, split="train", seed=0, unit=4)


@pytest.mark.release
def test_statistics_that_are_a_little_off_change_motion_and_not_text(task, model, dataset, before):
    other = with_statistics(task, rescaled(dataset.normalizer, 1.2, 0.1))
    make_task(dataset, other.evaluator, PROTOCOL, split="train", seed=0, unit=4)
    assert other.evaluator.fingerprint != task.evaluator.fingerprint
    after = figures(other, model)
    for row, found in after.items():
        assert changed(before[row], found) >= {"fid", "diversity", "matching_score"}, row
    (text, motion, _), (text_after, motion_after, _) = pairs(task), pairs(other)
    np.testing.assert_array_equal(text, text_after)
    assert np.all(np.any(motion != motion_after, axis=1))


@pytest.mark.release
def test_another_unit_of_the_features_changes_no_embedding(task, before):
    """Features, statistics of model and evaluator, all twice as large: a power of two, so nothing is rounded."""
    clips = [clip._replace(features=2 * clip.features) for clip in task.samples.clips]
    statistics = Normalizer(*(2 * column for column in task.evaluator.normalizer))
    model = TextToMotion(random_bundle()._replace(normalizer=statistics))
    after = figures(with_clips(with_statistics(task, statistics), clips), model)
    for row, found in after.items():
        names = {name.removeprefix(CLEANED) for name in changed(before[row], found)}
        assert names <= set(MotionQuality._fields), "only what is measured in meters"


@pytest.mark.release
def test_the_size_of_batches_does_not_matter(task, model, before, monkeypatch):
    monkeypatch.setattr(sources, "BATCH", 50)
    monkeypatch.setattr(embedding, "BATCH", 20)
    after = figures(task, model)
    for row, metrics in before.items():
        for metric, value in metrics.items():
            # Of two motions that are made alike either may be nearer by the last bit.
            # Bones are of one length after the clean-up: their variation is what rounding leaves, below 1e-5.
            ties = 1 / 32 if metric.startswith("r_precision") else 1e-7
            np.testing.assert_allclose(after[row][metric], value, rtol=1e-4, atol=ties, err_msg=f"{row} {metric}")


@pytest.mark.release
def test_what_the_model_draws_changes_the_generated_row_alone(task, model, before):
    after = figures(task, model, Greedy())
    assert after["real"] == before["real"]
    assert after["generated"]["multimodality"] < 1e-4 * before["generated"]["multimodality"], "greedy is one motion"
    assert changed(before["generated"], after["generated"]) >= {"fid", "diversity", "matching_score"}


@pytest.mark.release
def test_a_protocol_is_told_from_another_by_what_it_changes(task, model, before):
    """text-to-motion is t2m-gpt but for whose variety is measured; with fewer captions than it asks for, the same."""
    other = dataclasses.replace(find_protocol("text-to-motion"), samples_per_caption=10)
    assert figures(task._replace(protocol=other), model) == before
    real_lengths = dataclasses.replace(task.protocol, generated_length="real")
    after = figures(task._replace(protocol=real_lengths), model)
    assert after["real"] == before["real"]
    assert changed(before["generated"], after["generated"]) >= {"fid", "diversity", "matching_score"}


@pytest.mark.release
def test_labels_change_what_reads_labels(task, model, before):
    alike = task._replace(samples=task.samples._replace(labels=np.zeros(32, np.int32)))
    after = figures(alike, model)
    for row, found in after.items():
        by_label = {f"r_precision_{k}_by_label" for k in (1, 2, 3)}
        assert {found[metric] for metric in by_label} == {1.0}, row
        others = changed(before[row], found) - by_label
        assert all("label" in metric for metric in others), others
