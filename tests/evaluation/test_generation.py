"""Evaluation of generated motion: repeatable, interruptible, and by the rules of its protocol."""

import dataclasses
import json
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints.bundle import save_bundle
from t2m_jax.checkpoints.evaluator import load_evaluator_bundle, make_trained_evaluator, save_evaluator
from t2m_jax.cli.main import main
from t2m_jax.config import UserError
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.synthetic import write_synthetic_dataset
from t2m_jax.evaluation import generation
from t2m_jax.evaluation.generation import Subject, check_fit, evaluate_generation, load_samples, summarize
from t2m_jax.evaluation.protocols import SAMPLES_A_CAPTION, find_protocol, make_plan
from t2m_jax.models.evaluator import EvaluatorConfig, evaluator_shapes
from t2m_jax.sampling import TextToMotion
from t2m_jax.sampling.pipeline import generate_codes
from t2m_jax.sampling.strategies import Temperature
from t2m_jax.text.word_vectors import vocabulary_from_captions
from tests.tiny import random_bundle, random_variables, walking_normalizer

SMALL = EvaluatorConfig(
    movement_hidden=8, movement_dim=8, motion_hidden=8, text_hidden=8, embedding_dim=6, word_dim=5, num_words=40
)
HEADER = {"seed": 3}


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
def subject(synthetic_folder, evaluator):
    samples = load_samples(open_dataset(synthetic_folder), "train")[:36]
    model = TextToMotion(random_bundle())
    return Subject(model, evaluator, samples, find_protocol("t2m-gpt"), Temperature(), 196, 3)


@pytest.fixture(scope="module")
def report(subject):
    return evaluate_generation(subject, num_repeats=2, header=HEADER)


def test_a_report_has_both_rows_with_all_metrics(report):
    real, generated = report["rows"]["real"], report["rows"]["generated"]
    assert set(generated) - set(real) == {"multimodality"}
    assert {"fid", "matching_score", "diversity", "r_precision_1", "r_precision_3_texts_per_motion"} <= set(real)
    for row in (real, generated):
        for metric, figures in row.items():
            assert np.isfinite(figures["repeats"]).all(), metric
            assert len(figures["repeats"]) == 2
    assert real["fid"]["mean"] < generated["fid"]["mean"], "nobody trained the model"
    assert generated["multimodality"]["mean"] > 0


def test_the_same_seed_gives_the_same_figures_and_another_others(subject, report):
    assert evaluate_generation(subject, num_repeats=2, header=HEADER) == report
    other = evaluate_generation(subject._replace(seed=4), num_repeats=1, header=HEADER)
    assert other["rows"]["generated"]["fid"]["repeats"][0] != report["rows"]["generated"]["fid"]["repeats"][0]


def test_an_interrupted_evaluation_goes_on(subject, report, tmp_path, monkeypatch):
    partial = tmp_path / "report.json.partial"
    evaluate_repeat = generation.evaluate_repeat
    seen = []

    def interrupted(*arguments, repeat):
        seen.append(repeat)
        if len(seen) == 2:
            raise KeyboardInterrupt
        return evaluate_repeat(*arguments, repeat=repeat)

    monkeypatch.setattr(generation, "evaluate_repeat", interrupted)
    with pytest.raises(KeyboardInterrupt):
        evaluate_generation(subject, num_repeats=2, header=HEADER, partial=partial)
    assert evaluate_generation(subject, num_repeats=2, header=HEADER, partial=partial) == report
    assert seen == [0, 1, 1], "a repeat that was done is done again"


@pytest.mark.parametrize("content", ['{"header": {"seed": 4}, "repeats": [{}]}', "{", '{"repeats": 3}', "[]"])
def test_a_partial_result_of_something_else_is_not_used(content, tmp_path):
    (tmp_path / "partial").write_text(content)
    assert generation.load_partial(tmp_path / "partial", HEADER) == []


def test_only_samples_that_count_are_made(subject):
    plan = make_plan(subject.samples, subject.protocol, seed=1, repeat=0)
    items, numbers = generation._rows_of(plan, subject.protocol)
    assert len(items) == len(set(zip(items.tolist(), numbers.tolist(), strict=True)))
    np.testing.assert_array_equal(numbers[: len(plan.samples)], 0)
    made = {*plan.multimodality_pairs.ravel().tolist(), 0}
    assert set(numbers.tolist()) == made and len(items) == 32 * len(made) < 32 * SAMPLES_A_CAPTION


def test_lengths_can_be_those_of_real_motion(subject):
    codes = generation.generate_many(
        subject.model,
        np.zeros((3, 12), np.float32),
        generation.sample_keys(jax.random.key(0), jnp.arange(3), jnp.arange(3)),
        strategy=Temperature(),
        lengths=np.array([40, 164, 400]),
    )
    np.testing.assert_array_equal(codes.code_lengths, [10, 40, 40])


def test_motions_drawn_in_two_passes_are_those_of_one(subject):
    generator = np.random.default_rng(0)
    text = generator.normal(size=(40, 12)).astype(np.float32)
    keys = generation.sample_keys(jax.random.key(5), jnp.arange(40), jnp.arange(40))
    found = generation.generate_many(subject.model, text, keys, strategy=Temperature(), lengths=None)
    longest = subject.model.config.gpt.max_codes
    whole = generate_codes(
        subject.model.variables, jnp.asarray(text), keys, config=subject.model.config, strategy=Temperature(),
        min_codes=0, max_codes=longest,
    )  # fmt: skip
    lengths = np.asarray(whole.code_lengths)
    assert lengths.min() < longest // 2 < lengths.max(), "one pass alone was made"
    np.testing.assert_array_equal(found.code_lengths, np.maximum(lengths, 1))
    np.testing.assert_array_equal(found.codes[lengths > 0], np.asarray(whole.codes)[lengths > 0])


def test_strict_counts_every_caption(subject, evaluator):
    strict = subject._replace(protocol=find_protocol("strict"), samples=subject.samples[:20])
    rows = evaluate_generation(strict, num_repeats=1, header=HEADER)["rows"]
    assert "fid" not in rows["real"], "real motion taken whole is at no distance from itself"
    captions = sum(len(sample.captions) for sample in strict.samples)
    assert (rows["generated"]["r_precision_1"]["mean"] * captions) % 1 == pytest.approx(0, abs=1e-4)


def test_the_interval_is_that_of_the_field(golden_dir):
    arrays = np.load(golden_dir / "evaluation" / "diversity_multimodality.npz")
    found = summarize([{"row": {"metric": float(value)}} for value in arrays["ci_values"]])["row"]["metric"]
    assert found["mean"] == pytest.approx(float(arrays["ci_mean"]))
    assert found["interval"] == pytest.approx(float(arrays["ci_half_width"]))
    assert json.loads(json.dumps(found)) == found


def test_another_skeleton_is_refused(subject, evaluator, synthetic_folder):
    other = evaluator._replace(config=dataclasses.replace(evaluator.config, feature_dim=251))
    with pytest.raises(UserError, match="the evaluator reads 251"):
        check_fit(subject.model, other, open_dataset(synthetic_folder))


@pytest.fixture
def folders(evaluator, synthetic_folder, tmp_path):
    """A model and an evaluator of the data, on disk."""
    save_bundle(tmp_path / "model", random_bundle(), card="tiny")
    fitting = evaluator._replace(normalizer=open_dataset(synthetic_folder).normalizer)
    save_evaluator(tmp_path / "evaluator", fitting)
    return tmp_path


def command(folders, data, *options):
    given = {"--model": folders / "model", "--data": data, "--evaluator": folders / "evaluator", "--split": "train"}
    words = [str(word) for pair in given.items() for word in pair]
    return main(["evaluate", "generation", *words, *options])


def test_the_command_prints_a_table_and_writes_the_report(folders, synthetic_folder, capsys):
    path = folders / "report.json"
    assert command(folders, synthetic_folder, "--num-repeats", "1", "--json", str(path)) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("protocol t2m-gpt, model ")
    assert [line.split("|")[1].strip() for line in printed.splitlines()[-2:]] == ["real", "generated"]
    report = json.loads(path.read_text())
    assert report["evaluator"] == load_evaluator_bundle(folders / "evaluator").fingerprint
    assert f"{report['rows']['generated']['fid']['mean']:.3f} ±" in printed
    assert not list(folders.glob("*.partial"))


def test_an_evaluator_of_other_data_is_refused(folders, evaluator, synthetic_folder, capsys):
    shutil.rmtree(folders / "evaluator")
    save_evaluator(folders / "evaluator", evaluator)
    assert command(folders, synthetic_folder, "--num-repeats", "1") == 2
    assert "not those of the evaluator's data" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--protocol", "strikt"], "'strikt' is unknown"),
        (["--num-repeats", "0"], "--num-repeats 0"),
        (["--split", "nowhere"], "nowhere.txt"),
    ],
)
def test_mistakes_are_one_line(folders, synthetic_folder, options, says, capsys):
    assert command(folders, synthetic_folder, *options) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line
