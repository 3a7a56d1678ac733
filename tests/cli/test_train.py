"""`t2m train`: configs from file and command line, refusals before any work."""

import dataclasses

import pytest

from t2m_jax.checkpoints.run import create_run
from t2m_jax.cli.main import main
from t2m_jax.config import load_config
from t2m_jax.train import TrainVqVaeConfig, experiment

TINY = """
model: {num_codes: 16, code_dim: 8, width: 16, depth: 1}
window: 32
loop: {num_steps: 2, batch_size: 4, validate_every: 0}
"""


@pytest.fixture
def config_file(tmp_path, data_folder):
    path = tmp_path / "vqvae.yaml"
    path.write_text(f"data: {data_folder}\nrun: {tmp_path / 'run'}\n{TINY}")
    return path


@pytest.fixture
def trained(monkeypatch):
    """Returns what the command would train, instead of training it."""
    seen = []
    monkeypatch.setattr(experiment, "train", lambda config, *, resume: seen.append((config, resume)))
    return seen


def test_the_command_line_changes_fields(config_file, trained):
    assert main(["train", "vqvae", f"{config_file}", "--loop.seed", "9", "--model.width", "32", "--resume"]) == 0
    [(config, resume)] = trained
    assert resume
    assert (config.loop.seed, config.model.width, config.model.num_codes, config.window) == (9, 32, 16, 32)
    assert config.optimizer == TrainVqVaeConfig().optimizer


def test_unknown_keys_are_refused_with_the_nearest(refusal, config_file):
    config_file.write_text(config_file.read_text().replace("window:", "windw:"))
    line = refusal("train", "vqvae", config_file)
    assert f"{config_file}" in line
    assert "window" in line


def test_unknown_options_are_refused_with_the_nearest(refusal, config_file):
    assert "num_steps" in refusal("train", "vqvae", config_file, "--loop.num_stepz", "3")


def test_help_lists_the_fields(capsys):
    assert main(["train", "vqvae", "--help"]) == 0
    assert "--loop.num_steps" in capsys.readouterr().out.replace("-num-", "-num_").replace(".num-", ".num_")


def test_a_run_is_not_written_over(refusal, config_file):
    config = load_config(config_file, TrainVqVaeConfig)
    config.run.mkdir()
    create_run(config.run, "vqvae", config)
    assert "--resume" in refusal("train", "vqvae", config_file)
    assert "model.width" in refusal("train", "vqvae", config_file, "--resume", "--model.width", "32")


def test_a_model_that_does_not_fit_the_data_is_refused(refusal, config_file):
    line = refusal("train", "vqvae", config_file, "--model.feature_dim", "251")
    assert "251" in line
    assert "263" in line


def test_missing_places_are_named(refusal, config_file, tmp_path):
    assert "nowhere.yaml" in refusal("train", "vqvae", tmp_path / "nowhere.yaml")
    assert "nowhere" in refusal("train", "vqvae", config_file, "--data", tmp_path / "nowhere")
    assert "not a run" in refusal("train", "vqvae", config_file, "--resume")


def test_a_run_alone_is_enough_to_resume(config_file, trained, tmp_path):
    config = load_config(config_file, TrainVqVaeConfig)
    config.run.mkdir()
    create_run(config.run, "vqvae", config)
    assert main(["train", "vqvae", "--run", f"{config.run}", "--resume", "--loop.num_steps", "7"]) == 0
    [(resumed, resume)] = trained
    assert resume
    assert resumed == dataclasses.replace(config, loop=dataclasses.replace(config.loop, num_steps=7))


def test_a_run_of_another_kind_is_refused(refusal, config_file):
    config = load_config(config_file, TrainVqVaeConfig)
    config.run.mkdir()
    create_run(config.run, "vqvae", config)
    assert "t2m train vqvae" in refusal("train", "gpt", "--run", config.run, "--resume")
    assert "CONFIG is missing" in refusal("train", "vqvae", "--resume")
    assert "CONFIG is missing" in refusal("train", "vqvae", "--run", config.run)


def test_the_command_says_what_to_run_next(config_file, trained, capsys):
    assert main(["train", "vqvae", f"{config_file}"]) == 0
    said = capsys.readouterr()
    config = load_config(config_file, TrainVqVaeConfig)
    run = config.run
    assert said.out == f"{run}\n"
    assert said.err.splitlines()[-1] == f"next: t2m train gpt t2m-gpt/gpt --data {config.data} --vqvae {run}"
