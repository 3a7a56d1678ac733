"""Evaluation on the way: its table, the best weights, what a run then stands for, and all the same after a stop."""

import csv
import dataclasses
import functools
import logging
import shutil

import jax
import numpy as np
import pytest

from t2m_jax.checkpoints import best as best_files
from t2m_jax.checkpoints.best import BEST_FOLDER, Best, find_best, restore_trained, save_best
from t2m_jax.checkpoints.evaluator import load_trained_evaluator, save_evaluator
from t2m_jax.checkpoints.model import load_generator_run
from t2m_jax.checkpoints.run import Checkpoints, save_run_config
from t2m_jax.checkpoints.tokenizer import load_tokenizer
from t2m_jax.cli.main import main
from t2m_jax.config import config_from_dict, save_config
from t2m_jax.data.folder import open_dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.protocols import find_protocol
from t2m_jax.evaluation.run import evaluate
from t2m_jax.evaluation.sources import make_generation
from t2m_jax.evaluation.task import make_task
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.sampling import TextToMotion
from t2m_jax.sampling.programs import generate_codes
from t2m_jax.train import TrainVqVaeConfig, experiment, train
from t2m_jax.train.best import BestWeights
from t2m_jax.train.config import EvaluationConfig, GenerationEvaluationConfig, compiled_config
from t2m_jax.train.experiment import find_trainer, make_best
from t2m_jax.train.gpt import TrainGptConfig
from tests.tiny import gpt_training, random_evaluator, vqvae_training
from tests.train.conftest import assert_same_checkpoint, skip_updates, stop_at

pytestmark = pytest.mark.slow

STAGES = ("vqvae", pytest.param("gpt", marks=pytest.mark.slow))
"""With the stages that the fast tests leave out."""
TRAINED = (pytest.param("vqvae", marks=pytest.mark.release), "gpt")
"""Stages of tests that train again."""
STEPS = [3, 6, 8]
"""Where runs of eight updates are evaluated every three."""
STOP = 7
"""The update that never ends: the newest checkpoint is then that of step 4, the newest evaluation that of step 6."""


@pytest.fixture(scope="module")
def held_out(data, tmp_path_factory):
    """The data of the other tests, but with a validation split of one batch."""
    folder = tmp_path_factory.mktemp("evaluation") / "data"
    shutil.copytree(data, folder, ignore=shutil.ignore_patterns(".t2m-cache"))
    shutil.copyfile(folder / "train.txt", folder / "val.txt")
    return folder


@pytest.fixture(scope="module")
def evaluator(held_out):
    """An evaluator of the data that nobody trained."""
    folder = held_out.parent / "evaluator"
    save_evaluator(folder, random_evaluator()._replace(normalizer=open_dataset(held_out).normalizer))
    return folder


@pytest.fixture(scope="module")
def training(held_out, evaluator, runs):
    """Returns a function that gives the config of a stage."""

    def config(stage, run, data=held_out, **fields):
        fields = {"evaluator": evaluator, "every": 3} | fields
        if stage == "vqvae":
            evaluation = EvaluationConfig(**({"metric": "r_precision_1"} | fields))
            return dataclasses.replace(vqvae_training(data, run), evaluation=evaluation)
        evaluation = GenerationEvaluationConfig(**({"sampling": "sampled", "seed": 5} | fields))
        return dataclasses.replace(gpt_training(data, runs.vqvae, run), evaluation=evaluation)

    return config


@pytest.fixture(scope="module")
def finished(training, held_out):
    """Returns a function that gives the run of a stage, which was evaluated on the way."""

    @functools.cache
    def run(stage):
        config = training(stage, held_out.parent / stage)
        train(config)
        return config.run

    return run


def table(run):
    with (run / "evaluation.csv").open(encoding="utf-8") as file:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]


def files(run):
    """Returns what a run wrote of its metrics and its best weights."""
    names = ("train.csv", "val.csv", "evaluation.csv")
    paths = [*(run / name for name in names), *(run / BEST_FOLDER).glob("*/*")]
    return {f"{path.relative_to(run)}": path.read_bytes() for path in paths}


def trained_at(run, step, like):
    """Returns the weights of a checkpoint, by name."""
    with Checkpoints(run) as checkpoints:
        return checkpoints.restore_step(step, like)


@pytest.mark.release
@pytest.mark.parametrize("stage", STAGES)
def test_the_table_and_the_best(finished, stage):
    rows, best = table(finished(stage)), find_best(finished(stage))
    assert [row["step"] for row in rows] == STEPS
    assert {"fid", "matching_score", "r_precision_3", "diversity"} <= set(rows[0])
    assert "multimodality" not in rows[0], "one motion a caption has no variety"
    assert all(np.isfinite(list(row.values())).all() for row in rows)
    assert len({row["fid"] for row in rows}) == 3, "the weights do not move"
    metric, choose = {"vqvae": ("r_precision_1", max), "gpt": ("fid", min)}[stage]
    expected = choose(rows, key=lambda row: row[metric])
    assert (best.metric, best.step, best.value) == (metric, expected["step"], expected[metric])
    assert best.sampling == {"vqvae": None, "gpt": "sampled"}[stage]


def loaded(run, stage):
    """Returns the trained weights that whoever loads a run gets, as fields of its training state."""
    if stage == "vqvae":
        return load_tokenizer(run).variables
    variables = load_generator_run(run).variables
    roles = {"gpt": "generator", "caption_encoder": "text_encoder"}
    return {"params": {kind: variables[role]["params"] for kind, role in roles.items()}}


@pytest.mark.release
@pytest.mark.parametrize("stage", TRAINED)
def test_a_run_stands_for_its_best(training, stage, tmp_path):
    """Asked of runs that keep every checkpoint, so that the weights of the best step are known from elsewhere."""
    # By these metrics, the newest weights of the tiny models are not the best.
    config = training(stage, tmp_path / "run", metric={"vqvae": "fid", "gpt": "r_precision_3"}[stage])
    config = dataclasses.replace(config, loop=dataclasses.replace(config.loop, checkpoint_every=1, keep_checkpoints=9))
    train(config)
    best, last = find_best(config.run).step, config.loop.num_steps
    assert best < last, "the best is the newest: the test sees nothing"
    found = loaded(config.run, stage)
    jax.tree.map(np.testing.assert_array_equal, found, trained_at(config.run, best, found))
    shutil.rmtree(config.run / BEST_FOLDER)
    jax.tree.map(np.testing.assert_array_equal, loaded(config.run, stage), trained_at(config.run, last, found))


@pytest.mark.release
@pytest.mark.parametrize("stage", TRAINED)
def test_a_resumed_run_equals_one_that_never_stopped(finished, training, stage, tmp_path, monkeypatch):
    config = training(stage, tmp_path / "run")
    mend = stop_at(STOP, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        train(config)
    compiled = generate_codes._cache_size()
    assert compiled or stage == "vqvae"
    assert [row["step"] for row in table(config.run)] == [3, 6]
    assert find_best(config.run).step in (3, 6)
    mend()
    train(config, resume=True)
    assert files(config.run) == files(finished(stage))
    assert_same_checkpoint(config.run, finished(stage))
    assert generate_codes._cache_size() == compiled, "an evaluation compiled what was compiled before"


@pytest.mark.release
def test_figures_are_those_of_the_command(finished, held_out, evaluator):
    """The best weights, loaded and evaluated by protocol, give the row by which they were chosen."""
    protocol, best = find_protocol("t2m-gpt"), find_best(finished("gpt"))
    trained = load_trained_evaluator(evaluator)
    task = make_task(open_dataset(held_out), trained, protocol, split="val", seed=5, unit=4)
    source = make_generation(TextToMotion.load(finished("gpt")), task.samples.clips)
    report = evaluate(task, source, model="gpt", num_repeats=1)
    (row,) = [row for row in table(finished("gpt")) if row["step"] == best.step]
    for metric in ("fid", "matching_score", "r_precision_1", "r_precision_3"):
        assert report.measured[metric].mean == pytest.approx(row[metric], rel=1e-6), metric


@pytest.mark.release
def test_the_log_says_how_codes_were_chosen(training, tmp_path, caplog, monkeypatch):
    monkeypatch.setattr(experiment, "held_out_metrics", lambda task, source: {"fid": 7.0 + source.options.temperature})
    config = training("gpt", tmp_path / "run", sampling="greedy")
    with caplog.at_level(logging.INFO):
        train(config)
    assert "step 3, evaluation (val, greedy): fid 7" in caplog.messages
    assert sum("these weights are kept" in message for message in caplog.messages) == 1
    assert find_best(config.run).sampling == "greedy"


def test_another_evaluator_is_refused_on_the_way(training, held_out, tmp_path, monkeypatch):
    skip_updates(monkeypatch)
    config = vqvae_training(held_out, tmp_path / "run")
    train(dataclasses.replace(config, loop=dataclasses.replace(config.loop, validate_every=0)))
    config = training("vqvae", tmp_path / "run")
    save_run_config(config.run, config)
    best = Best(step=3, metric="r_precision_1", value=0.5, evaluator="another")
    save_best(config.run, best, {"params": {}})
    with pytest.raises(UserError, match="figures of two evaluators cannot be compared"):
        train(config, resume=True)


@pytest.fixture(params=STAGES)
def refusal(request, training, tmp_path, capsys):
    """Returns a function that trains a stage, which must be refused, and gives the one line that is said."""

    def start(**fields):
        save_config(tmp_path / "config.yaml", training(request.param, tmp_path / "run", **fields))
        assert main(["train", request.param, f"{tmp_path / 'config.yaml'}"]) == 2
        assert not (tmp_path / "run").exists(), "a run that cannot start was written"
        (line,) = capsys.readouterr().err.splitlines()
        return line

    return start


def test_an_evaluator_that_is_none_is_refused_before_training(refusal, tmp_path):
    assert f"{tmp_path / 'nowhere'}: not an evaluator" in refusal(evaluator=tmp_path / "nowhere")


def test_an_evaluator_of_other_data_is_refused_before_training(refusal, held_out, tmp_path):
    mean, std = open_dataset(held_out).normalizer
    save_evaluator(tmp_path / "evaluator", random_evaluator()._replace(normalizer=Normalizer(mean + std, std)))
    assert "differ too much from those of the evaluator" in refusal(evaluator=tmp_path / "evaluator")


def test_a_validation_split_of_less_than_a_batch_is_refused_before_training(refusal, runs):
    assert "do not fill a batch of 32" in refusal(data=runs.data)


@pytest.mark.release
def test_patience_counts_evaluations(training, tmp_path):
    """The metric of a model that stays the same is never better than the first time."""
    config = training("gpt", tmp_path / "run")
    still = dataclasses.replace(config.optimizer, learning_rate=0.0, warmup_steps=0)
    config = dataclasses.replace(config, patience=1, optimizer=still)
    every = config.evaluation.every
    assert 2 * every < config.loop.num_steps and config.loop.validate_every != every
    assert int(train(config).step) == 2 * every
    assert int(train(config, resume=True).step) == 2 * every, "it stays ended"


@pytest.mark.parametrize(
    ("schema", "fields", "says"),
    [
        (TrainGptConfig, {"metric": "diversity"}, "evaluation.metric: expected one of 'fid', 'matching_score'"),
        (TrainVqVaeConfig, {"metric": "mpjpe"}, "evaluation.metric: expected one of"),
        (TrainGptConfig, {"sampling": "likeliest"}, "evaluation.sampling: expected one of 'greedy', 'sampled'"),
        (TrainVqVaeConfig, {"sampling": "greedy"}, "unknown key 'evaluation.sampling'"),
        (TrainGptConfig, {"every": 0}, "evaluation: every: 0 is not a whole number above 0"),
        (TrainGptConfig, {"seed": -1}, "evaluation: seed: -1 is not between 0 and 4294967295"),
    ],
)
def test_what_makes_no_sense_is_refused(schema, fields, says):
    with pytest.raises(UserError) as caught:
        config_from_dict(schema, {"evaluation": fields}, source="config.yaml")
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("metric", "figures", "steps"),
    [
        ("fid", [3.0, 1.0, 2.0, 1.0, 0.5], [1, 2, 2, 2, 5]),
        ("matching_score", [3.0, float("nan"), 2.0, 4.0], [1, 1, 3, 3]),
        ("r_precision_1", [0.3, 0.1, 0.4, 0.4, float("nan")], [1, 1, 3, 3, 3]),
        ("r_precision_3", [float("nan"), 0.0, 0.1], [None, 2, 3]),
    ],
)
def test_the_best_is_kept_by_the_direction_of_its_metric(metric, figures, steps, tmp_path):
    def look():
        return BestWeights(tmp_path, metric=metric, sampling="greedy", evaluator="e")

    best = look()
    for step, (value, expected) in enumerate(zip(figures, steps, strict=True), start=1):
        best.consider(step, {metric: value, "other": -value}, {"params": {"a": np.full(2, step, np.float32)}})
        assert (best.best and best.best.step) == expected
        assert find_best(tmp_path) == best.best
        if expected:
            found = restore_trained(tmp_path, {"params": {"a": np.zeros(2, np.float32)}})
            np.testing.assert_array_equal(found["params"]["a"], expected)
            assert [path.name for path in (tmp_path / BEST_FOLDER).iterdir()] == [f"{expected}"]
    assert look().best == best.best


def test_the_same_update_measured_again_is_not_kept_again(tmp_path):
    """On a GPU, a resumed run may find another last digit."""
    for value in (1.0, 0.9999999):
        BestWeights(tmp_path).consider(5, {"loss": value}, {"params": {"a": np.zeros(2, np.float32)}})
    assert find_best(tmp_path).value == 1.0


@pytest.mark.parametrize("lost", ["save_arrays", "save_config", "write_manifest"])
def test_a_kill_while_the_best_is_written_leaves_that_of_before(lost, tmp_path, monkeypatch):
    def weights(step):
        return {"params": {"a": np.full(2, step, np.float32)}}

    best = Best(step=3, metric="fid", value=1.0, sampling=None, evaluator="e")
    save_best(tmp_path, best, weights(3))

    def killed(*arguments, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(best_files, lost, killed)
        with pytest.raises(KeyboardInterrupt):
            save_best(tmp_path, dataclasses.replace(best, step=6, value=0.5), weights(6))
    assert find_best(tmp_path) == best
    np.testing.assert_array_equal(restore_trained(tmp_path, weights(0))["params"]["a"], 3)
    save_best(tmp_path, dataclasses.replace(best, step=6, value=0.5), weights(6))
    np.testing.assert_array_equal(restore_trained(tmp_path, weights(0))["params"]["a"], 6)
    assert [path.name for path in (tmp_path / BEST_FOLDER).iterdir()] == ["6"]


def test_damaged_best_weights_are_refused(tmp_path):
    fields = {"params": {"a": np.arange(2.0)}}
    save_best(tmp_path, Best(step=3, metric="fid", value=1.0), fields)
    for path in (tmp_path / BEST_FOLDER / "3").iterdir():
        whole = path.read_bytes()
        path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
        with pytest.raises(UserError, match=f"{path}: .*copy"):
            restore_trained(tmp_path, fields)
        path.write_bytes(whole)
    restore_trained(tmp_path, fields)


@pytest.mark.parametrize("stage", STAGES)
def test_steps_are_compiled_for_the_same_config_with_and_without(training, stage, tmp_path):
    config = training(stage, tmp_path / "run")
    assert config.evaluation.evaluator is not None
    plain = dataclasses.replace(config, evaluation=type(config.evaluation)())
    assert compiled_config(config) == compiled_config(plain)


def test_training_ends_when_the_best_is_too_old(tmp_path):
    best = BestWeights(tmp_path)
    assert not best.is_over(10**6, patience=4), "nothing was measured yet"
    for step, loss in ((2, 3.0), (4, 1.0), (6, 2.0), (8, float("nan"))):
        best.consider(step, {"loss": loss}, {"params": {"a": np.full(2, step, np.float32)}})
        assert best.is_over(step, patience=4) == (step == 8)
    assert not BestWeights(tmp_path).is_over(10**6, patience=0)


def test_without_an_evaluator_the_lowest_validation_loss_chooses(runs):
    for run in (runs.vqvae, runs.gpt):
        rows = np.genfromtxt(run / "val.csv", delimiter=",", names=True)
        best = find_best(run)
        assert (best.metric, best.evaluator) == ("loss", None)
        assert best.step == rows["step"][np.argmin(rows["loss"])] and best.value == rows["loss"].min()


def test_the_start_says_what_chooses_the_weights_without_an_evaluator(data, tmp_path, caplog):
    setup = find_trainer("vqvae").prepare(vqvae_training(data, tmp_path), False)
    with caplog.at_level(logging.INFO):
        make_best(tmp_path, setup, None)
    assert "lowest validation loss" in caplog.text and "FID" in caplog.text


@pytest.mark.release
def test_a_picture_is_made_at_each_evaluation(finished):
    assert sorted(path.stem for path in (finished("gpt") / "pictures").iterdir()) == ["3", "6", "8"]
