"""Evaluation by repeats: repeatable, interruptible, and by the rules of its protocol."""

import dataclasses
import json
import shutil
from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints.bundle import save_bundle
from t2m_jax.checkpoints.evaluator import load_trained_evaluator, make_trained_evaluator, save_evaluator
from t2m_jax.cli.main import main
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.synthetic import write_synthetic_dataset
from t2m_jax.data.index import IndexEntry, load_index, save_index
from t2m_jax.errors import UserError
from t2m_jax.evaluation import embedding, sources
from t2m_jax.evaluation import run as repeats
from t2m_jax.evaluation.embedding import embed_decoded
from t2m_jax.evaluation.protocols import Protocol, find_protocol
from t2m_jax.evaluation.report.record import Metric, load_report
from t2m_jax.evaluation.run import evaluate, load_partial, make_header
from t2m_jax.evaluation.sources import (
    Reconstruction,
    encode_pieces,
    generate_many,
    make_generation,
    measured_samples,
    sample_keys,
)
from t2m_jax.evaluation.task import EvaluationTask, Samples, load_samples, make_task
from t2m_jax.metrics.quality import MotionQuality
from t2m_jax.models.evaluator import EvaluatorConfig, evaluator_shapes
from t2m_jax.sampling import TextToMotion
from t2m_jax.sampling.request import SamplingOptions
from t2m_jax.text.word_vectors import vocabulary_from_captions
from tests.tiny import random_bundle, random_variables, walking_normalizer

pytestmark = pytest.mark.slow

SMALL = EvaluatorConfig(
    movement_hidden=8, movement_dim=8, motion_hidden=8, text_hidden=8, embedding_dim=6, word_dim=5, num_words=40
)


@pytest.fixture(scope="module")
def synthetic_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("generation") / "data"
    write_synthetic_dataset(folder, num_clips=24, seed=3)
    return folder


@pytest.fixture(scope="module")
def evaluator():
    words = [f"word{chr(97 + number)}{chr(97 + number // 26)}/NOUN" for number in range(37)]
    vocabulary = vocabulary_from_captions([words], min_count=1)
    config = dataclasses.replace(SMALL, num_words=len(vocabulary))
    return make_trained_evaluator(config, random_variables(evaluator_shapes(config)), walking_normalizer(), vocabulary)


@pytest.fixture(scope="module")
def task(synthetic_folder, evaluator):
    clips, labels, _ = load_samples(open_dataset(synthetic_folder), "train")
    protocol = dataclasses.replace(find_protocol("t2m-gpt"), multimodality_captions=2)
    return EvaluationTask(evaluator, Samples(clips[:36], labels[:36], None), protocol, 196, 3)


@pytest.fixture(scope="module")
def generation(task):
    return make_generation(TextToMotion(random_bundle()), task.samples.clips)


@pytest.fixture(scope="module")
def report(task, generation):
    return evaluate(task, generation, num_repeats=2)


def test_a_report_has_both_rows_with_all_metrics(report):
    real, generated = report.real, report.measured
    assert set(report.metrics) == {"real", "generated"}
    assert set(generated) - set(real) == {"multimodality", *(f"cleaned_{name}" for name in MotionQuality._fields)}
    assert generated["cleaned_bone_variation"].mean < 1e-4 < generated["bone_variation"].mean
    assert set(real) - set(generated) == {f"r_precision_{k}_bound_by_label" for k in (1, 2, 3)}
    names = {"r_precision_1", "r_precision_3_texts_per_motion", "r_precision_2_by_label"}
    assert names | {"fid", "matching_score", "diversity"} <= set(real)
    for row in (real, generated):
        for metric, figures in row.items():
            assert np.isfinite(figures.repeats).all(), metric
            assert len(figures.repeats) == 2
        assert row["r_precision_1_by_label"].mean >= row["r_precision_1"].mean
    assert real["fid"].mean < generated["fid"].mean, "nobody trained the model"
    assert generated["multimodality"].mean > 0


def test_the_same_seed_gives_the_same_figures_and_another_others(task, generation, report):
    same = evaluate(task, generation, num_repeats=1)
    for again, before in ((same.real, report.real), (same.measured, report.measured)):
        assert {name: one.repeats[0] for name, one in again.items()} == {
            name: one.repeats[0] for name, one in before.items()
        }
    other = evaluate(task._replace(seed=4), generation, num_repeats=1)
    assert other.measured["fid"].repeats[0] != report.measured["fid"].repeats[0]
    with pytest.raises(UserError, match="num-repeats: 0 is not"):
        evaluate(task, generation, num_repeats=0)


def test_an_interrupted_evaluation_goes_on(task, generation, report, tmp_path, monkeypatch):
    partial = tmp_path / "report.json.partial"
    evaluate_repeat = repeats.evaluate_repeat
    seen = []

    def interrupted(*arguments, repeat):
        seen.append(repeat)
        if len(seen) == 2:
            raise KeyboardInterrupt
        return evaluate_repeat(*arguments, repeat=repeat)

    monkeypatch.setattr(repeats, "evaluate_repeat", interrupted)
    with pytest.raises(KeyboardInterrupt):
        evaluate(task, generation, num_repeats=2, partial=partial)
    assert evaluate(task, generation, num_repeats=2, partial=partial) == report
    assert seen == [0, 1, 1], "a repeat that was done is done again"


def test_an_evaluation_does_not_go_on_with_another_model_or_other_data(task, generation, tmp_path):
    partial = tmp_path / "report.json.partial"
    evaluate(task, generation, num_repeats=1, partial=partial)
    other = make_generation(TextToMotion(random_bundle(seed=1)), task.samples.clips)
    with pytest.raises(UserError, match=r"partial: keeps the repeats of an evaluation with other weights \(\w+, not"):
        evaluate(task, other, num_repeats=2, partial=partial)
    with pytest.raises(UserError, match=r"with other contents \(, not abc\)"):
        evaluate(task._replace(contents="abc"), generation, num_repeats=2, partial=partial)
    moved = load_partial(partial, make_header(task._replace(data="moved"), generation, model="elsewhere"))
    assert len(moved) == 1, "what only moved is the same"


def change_a_clip(folder):
    path = min((folder / "new_joint_vecs").iterdir())
    features = np.load(path)
    features[0, 4] += 1e-3
    np.save(path, features)


def change_a_label(folder):
    rows = load_index(folder)
    save_index(folder, [IndexEntry(name, "", f"{row.label}!") for name, row in rows.entries.items()])


@pytest.mark.parametrize("change", [change_a_clip, change_a_label])
def test_the_contents_of_the_data_are_in_the_task_and_the_report(synthetic_folder, evaluator, tmp_path, change):
    def header(folder):
        task = make_task(open_dataset(folder), evaluator, protocol, split="train", seed=0, unit=4)
        generation = make_generation(TextToMotion(random_bundle()), task.samples.clips)
        return make_header(task, generation, model="")

    protocol = find_protocol("t2m-gpt")
    evaluator = evaluator._replace(normalizer=open_dataset(synthetic_folder).normalizer)
    original = shutil.copytree(synthetic_folder, tmp_path / "data")
    save_index(original, [IndexEntry("synthetic_00000", "", "walk")])
    folder = shutil.copytree(original, tmp_path / "moved")
    assert header(folder) == header(original) and header(folder).weights
    change(folder)
    assert header(folder).contents != header(original).contents


@pytest.mark.parametrize("content", ['{"header": {"seed": 4}, "repeats": [{}]}', "{", '{"repeats": 3}', "[]"])
def test_a_partial_result_of_something_else_is_not_used(task, generation, content, tmp_path):
    (tmp_path / "partial").write_text(content)
    assert load_partial(tmp_path / "partial", make_header(task, generation, model="")) == []


@pytest.mark.parametrize(("per_number", "is_few"), [(2, False), (1.9, True)])
def test_fid_of_few_motions_has_a_warning(task, generation, per_number, is_few):
    """`strict` uses a motion once for each caption. What counts is how many motions there are."""
    count = len(np.unique(task.plan(0).samples))
    config = dataclasses.replace(task.evaluator.config, embedding_dim=round(count / per_number))
    header = make_header(task._replace(evaluator=task.evaluator._replace(config=config)), generation, model="")
    assert bool(header.fid_warning) == is_few
    assert not is_few or f"FID is not reliable: {count} motions are too few" in header.fid_warning


@pytest.mark.parametrize(
    "repeats",
    [
        [[{}, {}]],
        [[{"fid": 1.0}, {"fid": float("nan")}]],
        [[{"fid": 1.0}, {"fid": "1"}]],
        [[{"fid": 1.0}, [2.0]]],
        [[{"fid": 1.0}, {"fid": 1.0}], [{"fid": 1.0}, {"diversity": 1.0}]],
    ],
)
def test_unsound_repeats_of_a_partial_result_are_not_used(repeats, task, generation, caplog, tmp_path):
    header = make_header(task, generation, model="")
    (tmp_path / "partial").write_text(json.dumps({"header": dataclasses.asdict(header), "repeats": repeats}))
    assert load_partial(tmp_path / "partial", header) == []
    assert "is damaged; the evaluation starts over" in caplog.text


def plan_of(task):
    return task._replace(seed=1).plan(repeat=0)


def test_only_measured_samples_are_made(task):
    protocol = find_protocol("t2m-gpt")
    plan = plan_of(task._replace(protocol=protocol))
    items, numbers = measured_samples(plan, protocol)
    assert len(items) == len(set(zip(items.tolist(), numbers.tolist(), strict=True)))
    np.testing.assert_array_equal(numbers[: len(plan.samples)], 0)
    made = {*plan.multimodality_pairs.ravel().tolist(), 0}
    assert set(numbers.tolist()) == made and len(items) == 32 * len(made) < 32 * protocol.samples_per_caption


def test_variety_can_be_left_out(task, generation, report):
    brief = task._replace(protocol=dataclasses.replace(task.protocol, multimodality_captions=0))
    metrics = repeats.evaluate_repeat(brief, generation, repeat=0).measured
    assert "multimodality" not in metrics
    assert metrics["fid"] == pytest.approx(report.measured["fid"].repeats[0], rel=1e-4)


def test_a_reconstruction_is_real_motion_through_the_tokenizer(task, generation):
    source = Reconstruction(generation.tokenizer)
    metrics = repeats.evaluate_repeat(task, source, repeat=0).measured
    plan = plan_of(task)._replace(starts=np.zeros(32, int))
    made = source.make(task.samples.clips, task.protocol, plan, jax.random.key(0))
    np.testing.assert_array_equal(made.codes.code_lengths, plan.lengths // 4)
    sample = task.samples.clips[plan.samples[5]].features[: plan.lengths[5]]
    alone = encode_pieces(generation.tokenizer, [sample])
    np.testing.assert_array_equal(made.codes.codes[5, : len(sample) // 4], alone.codes[0])
    assert "fid" in metrics and "multimodality" not in metrics


def test_lengths_can_be_those_of_real_motion(generation):
    codes = generate_many(
        generation.model,
        np.zeros((3, 12), np.float32),
        sample_keys(jax.random.key(0), jnp.arange(3), jnp.arange(3)),
        sampling=generation.model.parts.sampling(SamplingOptions(max_codes=40), min_codes=0),
        lengths=np.array([40, 164, 400]),
        exact=True,
    )
    np.testing.assert_array_equal(codes.code_lengths, [10, 40, 40])
    assert not codes.codes[0, 10:].any() and codes.codes[1].any()


def test_what_is_expected_of_the_lengths_changes_no_motion(generation, monkeypatch):
    # So that the motions of a batch that are longer than expected are generated twice.
    monkeypatch.setattr(sources, "CHUNK", 24)
    monkeypatch.setattr(sources, "BATCH", 16)
    generator = np.random.default_rng(0)
    text = generator.normal(size=(40, 12)).astype(np.float32)
    keys = sample_keys(jax.random.key(5), jnp.arange(40), jnp.arange(40))
    model, longest = generation.model, generation.model.config.generator.max_codes
    sampling = model.parts.sampling(SamplingOptions(max_codes=longest), min_codes=0)
    found = generate_many(model, text, keys, sampling=sampling, lengths=generator.integers(4, 160, 40))
    whole = model.parts.sample_codes(jnp.asarray(text), keys, sampling)
    lengths = np.asarray(whole.code_lengths)
    assert lengths.min() < longest // 2 < lengths.max(), "one pass alone was made"
    np.testing.assert_array_equal(found.code_lengths, np.maximum(lengths, 1))
    np.testing.assert_array_equal(found.codes[lengths > 0], np.asarray(whole.codes)[lengths > 0])


@pytest.mark.release
def test_strict_counts_every_caption(task, generation):
    # Two clips with the same caption would each have a part of its rank.
    texts = Counter(caption.text for clip in task.samples.clips[:12] for caption in clip.captions)
    clips = [
        clip._replace(captions=tuple(caption for caption in clip.captions if texts[caption.text] == 1))
        for clip in task.samples.clips[:12]
    ]
    protocol = dataclasses.replace(find_protocol("strict"), multimodality_captions=4)
    strict = task._replace(protocol=protocol, samples=Samples(clips, None, None))
    report = evaluate(strict, generation, num_repeats=1)
    assert "fid" not in report.real, "real motion taken whole is at no distance from itself"
    assert "r_precision_1_by_label" not in report.real, "nothing is known of labels"
    captions = sum(len(sample.captions) for sample in clips)
    assert (report.measured["r_precision_1"].mean * captions) % 1 == pytest.approx(0, abs=1e-4)


def test_strict_leaves_out_what_shares_a_recording_with_training(synthetic_folder, tmp_path):
    folder = shutil.copytree(synthetic_folder, tmp_path / "data")
    dataset = open_dataset(folder)
    assert load_samples(dataset, "test", source_disjoint=True).shared == 0
    trained = next(name for name in dataset.names("train") if not name.startswith("M"))
    held_out = next(name for name in dataset.names("test") if not name.startswith("M"))
    lines = (folder / "index.csv").read_text().splitlines()
    moved = [line.replace(f",{held_out},", f",{trained},") for line in lines]
    (folder / "index.csv").write_text("\n".join(moved))
    whole, disjoint = (load_samples(dataset, "test", source_disjoint=asked) for asked in (False, True))
    assert (whole.shared, disjoint.shared) == (None, 2), "clip and twin"
    names = {clip.name for clip in whole.clips} - {clip.name for clip in disjoint.clips}
    assert names == {held_out, f"M{held_out}"}
    (folder / "index.csv").unlink()
    assert load_samples(dataset, "test", source_disjoint=True)[1:] == (None, None)


def test_decoding_in_a_longer_batch_changes_nothing(task, generation, monkeypatch):
    monkeypatch.setattr(embedding, "FRAME_BUCKET", 100)  # so that the batches have different lengths
    made = generation.make(task.samples.clips, task.protocol, plan_of(task), jax.random.key(0))
    # The last of the four has all its codes, so that reading more of them makes a difference.
    chosen = [0, 1, 2, int(np.argmax(made.codes.code_lengths))]
    first = made.codes._replace(codes=made.codes.codes[chosen], code_lengths=np.array([3, 3, 4, 3], np.int32))
    longer = first._replace(code_lengths=np.array([3, 3, 4, 40]))
    together, alone = (embed_decoded(task, generation.tokenizer, codes) for codes in (longer, first))
    np.testing.assert_allclose(together.embeddings[:3], alone.embeddings[:3], atol=2e-5)
    assert np.abs(together.embeddings[3] - alone.embeddings[3]).max() > 1e-3
    for one, other in zip(jax.tree.leaves(together.quality), jax.tree.leaves(alone.quality), strict=True):
        np.testing.assert_allclose(one[:3], other[:3], rtol=1e-3, atol=1e-3)


def test_the_interval_is_that_of_the_field(golden_dir):
    arrays = np.load(golden_dir / "evaluation" / "diversity_multimodality.npz")
    found = Metric.from_repeats([float(value) for value in arrays["ci_values"]])
    assert found.mean == pytest.approx(float(arrays["ci_mean"]))
    assert found.interval == pytest.approx(float(arrays["ci_half_width"]))


def test_another_skeleton_is_refused(evaluator, synthetic_folder):
    other = evaluator._replace(config=dataclasses.replace(evaluator.config, feature_dim=251))
    with pytest.raises(UserError, match="the evaluator reads 251"):
        make_task(open_dataset(synthetic_folder), other, find_protocol("t2m-gpt"), split="train", seed=0, unit=4)


@pytest.fixture
def folders(evaluator, synthetic_folder, tmp_path):
    """A model and an evaluator of the data, on disk."""
    save_bundle(tmp_path / "model", random_bundle(), card="tiny")
    fitting = evaluator._replace(normalizer=open_dataset(synthetic_folder).normalizer)
    save_evaluator(tmp_path / "evaluator", fitting)
    return tmp_path


def command(folders, data, *options, what="generation"):
    given = {"--model": folders / "model", "--data": data, "--evaluator": folders / "evaluator", "--split": "train"}
    words = [str(word) for pair in given.items() for word in pair]
    return main(["evaluate", what, *words, *options])


@pytest.mark.release
def test_the_command_prints_a_table_and_writes_the_report(folders, synthetic_folder, capsys):
    path = folders / "report.json"
    assert command(folders, synthetic_folder, "--num-repeats", "1", "--json", str(path)) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("protocol t2m-gpt, model ")
    names = [line.split("  ")[0] for line in printed.splitlines()]
    assert [name for name in names if name in ("real motion", "generated")] == 2 * ["real motion", "generated"]
    assert "FID" in printed and "Jerk" in printed
    report = json.loads(path.read_text())
    assert report["evaluator"] == load_trained_evaluator(folders / "evaluator").fingerprint
    assert f"{report['rows']['generated']['fid']['mean']:.3f} ±" in printed
    assert not list(folders.glob("*.partial"))
    assert load_report(path).header.model == str(folders / "model")


@pytest.mark.release
def test_reconstruction_by_a_protocol_is_a_row_like_those_of_generation(folders, synthetic_folder, capsys):
    path = folders / "report.json"
    assert command(folders, synthetic_folder, "--num-repeats", "1", "--json", str(path), what="reconstruction") == 0
    report = json.loads(path.read_text())
    assert set(report["rows"]) == {"real", "reconstruction"} and report["sampling"] == "none"
    assert report["mpjpe_mm"] > 0 and "protocol t2m-gpt, model " in capsys.readouterr().out
    assert load_report(path).reconstruction.quality.jerk == report["quality"]["jerk"] > 0


def test_an_evaluator_of_other_data_is_refused(folders, evaluator, synthetic_folder, capsys):
    shutil.rmtree(folders / "evaluator")
    save_evaluator(folders / "evaluator", evaluator)
    assert command(folders, synthetic_folder, "--num-repeats", "1") == 2
    assert "differ too much from those of the evaluator" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--protocol", "strikt"], "'strikt' is unknown"),
        (["--num-repeats", "0"], "--num-repeats: 0"),
        (["--split", "nowhere"], "nowhere.txt"),
    ],
)
def test_mistakes_are_one_line(folders, synthetic_folder, options, says, capsys):
    assert command(folders, synthetic_folder, *options) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line


def test_the_unit_is_of_the_tokenizer_and_the_evaluator(evaluator, synthetic_folder):
    dataset = open_dataset(synthetic_folder)
    fitting = evaluator._replace(normalizer=dataset.normalizer)
    tasks = {
        unit: make_task(dataset, fitting, Protocol(name="small", batch=16), split="train", seed=0, unit=unit)
        for unit in (2, 4, 6, 64)
    }
    assert [task.unit for task in tasks.values()] == [4, 4, 12, 64]
    shortest = {unit: min(len(clip.features) for clip in task.samples.clips) for unit, task in tasks.items()}
    assert shortest[4] < 64 <= shortest[64], "a motion without a whole unit is left out"


@pytest.mark.release
def test_a_small_split_needs_a_smaller_batch(folders, synthetic_folder, capsys):
    path, data = folders / "report.json", shutil.copytree(synthetic_folder, folders / "data")
    (data / "few.txt").write_text("\n".join(open_dataset(data).names("train")[:6]))
    options = ["--num-repeats", "1", "--split", "few", "--json", str(path)]
    assert command(folders, data, *options) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert (
        "split few" in line
        and "do not fill a batch of 32; use another split, or a smaller batch (`t2m evaluate" in line
    )
    sampling = ["--temperature", "0.5", "--top-k", "3"]
    assert command(folders, data, *options, "--batch", "4", *sampling) == 0
    header = load_report(path).header
    assert (header.batch, header.unit, header.split) == (4, 4, "few")
    assert (header.sampling, header.temperature, header.top_k, header.top_p) == ("sampled", 0.5, 3, None)
    assert capsys.readouterr().err.splitlines()[-1] == f"next: t2m evaluate table {path}"
