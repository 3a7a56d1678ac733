"""`t2m evaluate`: tables, JSON, and one line for mistakes."""

import argparse
import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from t2m_jax.checkpoints.bundle import save_bundle
from t2m_jax.cli.evaluate import FREE_GROUPS, PLAIN_GROUPS, _measure
from t2m_jax.cli.main import main
from t2m_jax.errors import UserError
from t2m_jax.evaluation import run
from t2m_jax.evaluation.prompts import following
from t2m_jax.evaluation.prompts.catalog import prompt_tests
from t2m_jax.evaluation.report.record import Header, Metric, Report
from tests.tiny import random_bundle


@pytest.mark.slow
def test_reconstruction_writes_json(bundle_folder, data_folder, tmp_path, capsys):
    output = tmp_path / "figures.json"
    arguments = ["--model", f"{bundle_folder}", "--data", f"{data_folder}", "--json", f"{output}"]
    assert main(["evaluate", "reconstruction", *arguments]) == 0
    figures = json.loads(output.read_text())
    assert figures["mpjpe_mm"] > 0
    assert 0 < figures["codebook_usage"] <= 1
    assert figures["split"] == "test"
    assert f"{figures['mpjpe_mm']:,.3f}" in capsys.readouterr().out
    assert main(["check", f"{output}"]) == 0
    said = f"intact, a report of `t2m evaluate reconstruction` on {figures['num_clips']} clips"
    assert capsys.readouterr().out == f"{output}: {said}\n"


@pytest.mark.slow
def test_inbetween_prints_a_table(bundle_folder, data_folder, capsys):
    arguments = ["--model", f"{bundle_folder}", "--data", f"{data_folder}", "--split", "train", "--num-clips", "1"]
    assert main(["evaluate", "inbetween", *arguments, "--seconds", "0.4"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "| 1 clips | real | generated | interpolated |" and len(lines) == 6
    assert main(["evaluate", "inbetween", *arguments, "--seconds", "-1"]) == 2
    assert "seconds: -1 is not a number above 0" in capsys.readouterr().err


@pytest.mark.slow
def test_prompts_writes_json(bundle_folder, tmp_path, capsys):
    output = tmp_path / "figures.json"
    arguments = ["--model", f"{bundle_folder}", "--num-seeds", "1", "--json", f"{output}"]
    assert main(["evaluate", "prompts", *arguments]) == 0
    figures = json.loads(output.read_text())
    assert figures["num_samples"] == 11
    assert len(figures["contents"]) == 11
    assert (figures["group"], figures["motion"]) == ("actions", "cleaned")
    assert "| **all** |" in capsys.readouterr().out
    assert main(["evaluate", "prompts", *arguments, "--group", "composed", "--raw"]) == 0
    figures = json.loads(output.read_text())
    assert (figures["group"], figures["motion"], figures["num_samples"]) == ("composed", "decoded", 10)
    capsys.readouterr()
    assert main(["check", f"{output}"]) == 0
    said = "intact, a report of `t2m evaluate prompts --group composed` on 10 motions"
    assert capsys.readouterr().out == f"{output}: {said}\n"


@pytest.mark.slow
def test_prompts_are_measured_without_warnings(tmp_path, monkeypatch, capsys):
    original = following.evaluate_prompt_following
    data = {"words": {"a": 9, "person": 9, "walks": 9}, "actions": {"walk": 9}}
    save_bundle(tmp_path / "model", random_bundle()._replace(training_data=data), card="# tiny\n")

    def measure(tests, generate, *, num_seeds):
        generate("a person swims north", 0)  # of which the model warns
        return original([tests[0]._replace(sentences=tests[0].sentences[:1])], generate, num_seeds=1)

    monkeypatch.setattr(following, "evaluate_prompt_following", measure)
    assert main(["evaluate", "prompts", "--model", f"{tmp_path / 'model'}"]) == 0
    assert "warning" not in capsys.readouterr().err.lower()


def test_names_in_data_do_not_change_the_terminal(monkeypatch, capsys):
    """The data set, its split and the model may come from strangers."""
    names = {"data": "\x1b[31mred", "split": "\x9b31m", "model": "\x1b]0;title\x07"}
    sizes = {"num_samples": 64, "unit": 4, "batch": 32}
    header = Header(**names, **sizes, protocol="strict", evaluator="ab", weights="ab", contents="cd", seed=0)
    metrics = {name: Metric.from_repeats([1.0, 2.0]) for name in ("fid", "bone_variation")}
    report = Report(header=header, kind="generated", real=metrics, measured=metrics)
    monkeypatch.setattr(run, "evaluate", lambda *_, **__: report)
    arguments = argparse.Namespace(json=None, html=None, num_repeats=2, model="m")
    _measure(arguments, None, SimpleNamespace(kind="generated"))
    lines = capsys.readouterr().out.splitlines()
    assert "data \\x1b[31mred, split \\x9b31m" in lines[0]
    assert all(line.isprintable() for line in lines)


def test_a_model_of_another_width_is_refused(refusal, bundle_folder, data_folder, tmp_path):
    kit = tmp_path / "kit"
    shutil.copytree(data_folder, kit)
    (kit / "dataset.yaml").unlink()
    for path in (kit / "new_joint_vecs").iterdir():
        np.save(path, np.load(path)[:, :251])
    for name in ("Mean", "Std"):
        np.save(kit / f"{name}.npy", np.load(kit / f"{name}.npy")[:251])
    line = refusal("evaluate", "reconstruction", "--model", bundle_folder, "--data", kit)
    assert "251" in line
    assert "263" in line


def test_data_of_nothing_but_nan_are_refused(refusal, bundle_folder, data_folder, tmp_path):
    broken = tmp_path / "nan"
    shutil.copytree(data_folder, broken)
    for path in (broken / "new_joint_vecs").iterdir():
        np.save(path, np.full_like(np.load(path), np.nan))
    line = refusal("evaluate", "reconstruction", "--model", bundle_folder, "--data", broken)
    assert "test.txt" in line and "with NaN or infinite values" in line


def test_mistakes_are_told_in_one_line(refusal, bundle_folder, data_folder, tmp_path):
    assert "--data" in refusal("evaluate", "reconstruction", "--model", bundle_folder)
    assert "no data set" in refusal("evaluate", "reconstruction", "--model", bundle_folder, "--data", tmp_path)
    arguments = ("evaluate", "reconstruction", "--model", bundle_folder, "--data", data_folder)
    assert "does not exist" in refusal(*arguments, "--json", tmp_path / "no" / "figures.json")
    assert "nonsense" in refusal(*arguments, "--split", "nonsense")
    assert "--num-seeds" in refusal("evaluate", "prompts", "--model", bundle_folder, "--num-seeds", "0")
    for options in (("--group", "paces"), ("--group", "manners"), ("--data", data_folder)):
        assert "--data" in refusal("evaluate", "prompts", "--model", bundle_folder, *options)
    assert "label" in refusal(
        "evaluate", "prompts", "--group", "manners", "--data", data_folder, "--model", bundle_folder
    )
    for option in ("--temperature", "--guidance-scale"):
        assert option[2:] in refusal("evaluate", "prompts", "--model", bundle_folder, option, "-1")


@pytest.mark.parametrize("group", (*PLAIN_GROUPS, *FREE_GROUPS))
def test_each_group_of_prompts_has_tests_or_asks_for_data(group):
    try:
        assert prompt_tests(group, None)
    except UserError as error:
        assert group in f"{error}" and "--data" in f"{error}"
