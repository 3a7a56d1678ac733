"""What training does not take: sizes that describe nothing, data that hold nothing, data of another width."""

import dataclasses
import math
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from t2m_jax.checkpoints.run import STARTED, is_run
from t2m_jax.cli.main import main
from t2m_jax.config import config_from_dict, save_config
from t2m_jax.data.files import FEATURES
from t2m_jax.errors import UserError
from t2m_jax.train import TrainEvaluatorConfig, TrainVqVaeConfig, experiment, train
from t2m_jax.train.config import ShardingConfig
from t2m_jax.train.gpt import TrainGptConfig
from t2m_jax.train.hifigpt import TrainHiFiGptConfig
from t2m_jax.train.vqvae_config import TrainRvqVaeConfig
from tests.tiny import gpt_training, vqvae_training


@pytest.mark.parametrize(
    ("schema", "data", "says"),
    [
        (TrainVqVaeConfig, {"model": {"width": 0}}, "model: width: 0 is not a whole number above 0"),
        (TrainVqVaeConfig, {"model": {"num_stages": -1}}, "model: num_stages: -1"),
        (TrainVqVaeConfig, {"window": 3}, "window: 3 is shorter than one code, 4 frames"),
        (TrainVqVaeConfig, {"window": 7, "model": {"num_stages": 3}}, "window: 7 is shorter than one code, 8 frames"),
        (TrainVqVaeConfig, {"loop": {"batch_size": 0}}, "loop: batch_size: 0"),
        (TrainVqVaeConfig, {"loop": {"batch_size": 10**9}}, "loop: batch_size: 1000000000 is more than 65536"),
        (TrainGptConfig, {"loop": {"steps_per_call": 10**9}}, "loop: steps_per_call: 1000000000 is more than 10000"),
        (TrainGptConfig, {"loop": {"keep_checkpoints": 0}}, "loop: keep_checkpoints: 0"),
        (TrainGptConfig, {"loop": {"num_steps": -5}}, "loop: num_steps: -5"),
        (TrainGptConfig, {"loop": {"seed": -1}}, "loop: seed: -1 is not between 0 and 4294967295"),
        (TrainGptConfig, {"loop": {"seed": 2**32}}, "loop: seed: 4294967296 is not between"),
        (TrainGptConfig, {"loop": {"log_every": -1}}, "loop: log_every: -1 is not a number from 0 up"),
        (TrainVqVaeConfig, {"root_weight": 0.0}, "root_weight: 0.0 is not above 0"),
        (TrainVqVaeConfig, {"optimizer": {"milestones": [2**31]}}, "optimizer: warmup_steps, milestones: 2147483648"),
        (TrainVqVaeConfig, {"optimizer": {"warmup_steps": -5}}, "optimizer: warmup_steps, milestones: -5 is not a"),
        (TrainVqVaeConfig, {"optimizer": {"learning_rate": -1}}, "optimizer: learning_rate: -1.0 is not a number from"),
        (TrainGptConfig, {"optimizer": {"learning_rate": math.inf}}, "optimizer: learning_rate: inf is not a number"),
        (TrainVqVaeConfig, {"velocity_weight": -0.5}, "velocity_weight: -0.5 is not a number from 0 up"),
        (TrainRvqVaeConfig, {"bone_weight": math.inf}, "bone_weight: inf is not a number from 0 up"),
        (TrainHiFiGptConfig, {"stop_positive_weight": -1.0}, "stop_positive_weight: -1.0 is not a number from 0 up"),
        (TrainEvaluatorConfig, {"sparsity_weight": -0.001}, "sparsity_weight: -0.001 is not a number from 0 up"),
        (TrainVqVaeConfig, {"window": 10**9}, "window: 1000000000 is more than 10000"),
        (TrainEvaluatorConfig, {"window": 10**9}, "window: 1000000000 is more than 10000"),
        (TrainGptConfig, {"model": {"block_size": 1}}, "model: block_size: 1 leaves no position"),
        (TrainGptConfig, {"model": {"num_heads": 0}}, "model: num_heads: 0"),
        (TrainGptConfig, {"model": {"num_heads": 7}}, "model: num_heads: 7 does not divide"),
        (
            TrainGptConfig,
            {"model": {"text_dim": 6}},
            "caption_encoder.text_dim: 512, but the generator reads model.text_dim 6",
        ),
        (TrainGptConfig, {"tau": 1.5}, "tau: 1.5 is not a number from 0 to 1"),
        (TrainGptConfig, {"drop_probability": 33.0}, "drop_probability: 33.0 is not a number from 0 to 1"),
        (TrainGptConfig, {"model": {"dropout": 10.0}}, "model: dropout: 10.0 is not a number from 0 to below 1"),
        (TrainGptConfig, {"caption_encoder": {"dropout": 1.0}}, "caption_encoder: dropout: 1.0 is not a number from"),
        (TrainHiFiGptConfig, {"model": {"dropout": -0.1}}, "model: dropout: -0.1 is not a number from 0 to below 1"),
        (TrainVqVaeConfig, {"model": {"ema_decay": 99.0}}, "model: ema_decay: 99.0 is not a number from 0 to 1"),
        (TrainGptConfig, {"tau": "per_day"}, "tau: expected a number or one of"),
        (TrainGptConfig, {"data_fraction": 0.0}, "data_fraction: 0.0 is not a share above 0"),
        (TrainVqVaeConfig, {"data_fraction": 1.01}, "data_fraction: 1.01 is not a share above 0"),
        (TrainGptConfig, {"caption_encoder": {"num_heads": 3}}, "caption_encoder: num_heads: 3 does not divide"),
        (TrainGptConfig, {"caption_encoder": {"max_length": 0}}, "caption_encoder: max_length: 0"),
    ],
)
def test_sizes_that_describe_nothing(schema, data, says):
    with pytest.raises(UserError) as caught:
        config_from_dict(schema, data, source="config.yaml")
    assert str(caught.value).startswith(f"config.yaml: {says}")


@pytest.fixture(params=["vqvae", "gpt"])
def refusal(request, runs, tmp_path, capsys):
    """Returns a function that trains a stage on data, which must be refused, and gives the one line that is said."""

    def train(data):
        config = {
            "vqvae": lambda: vqvae_training(data, tmp_path / "run"),
            "gpt": lambda: gpt_training(data, runs.vqvae, tmp_path / "run"),
        }[request.param]()
        save_config(tmp_path / "config.yaml", config)
        assert main(["train", request.param, f"{tmp_path / 'config.yaml'}"]) == 2
        assert not (tmp_path / "run").exists(), "a run that cannot start was written"
        (line,) = capsys.readouterr().err.splitlines()
        return line

    return train


@pytest.fixture
def copy(data, tmp_path):
    shutil.copytree(data, tmp_path / "data")
    return tmp_path / "data"


def features_of(folder):
    return sorted((folder / FEATURES).iterdir())


def test_data_of_nothing_but_nan(refusal, copy):
    for path in features_of(copy):
        np.save(path, np.full_like(np.load(path), np.nan))
    assert "train.txt: 32 of 32 clips cannot be used: 32 with NaN or infinite values" in refusal(copy)


def test_data_of_another_width(refusal, copy):
    (copy / "dataset.yaml").unlink()
    for path in [*features_of(copy), copy / "Mean.npy", copy / "Std.npy"]:
        np.save(path, np.load(path)[..., :251])
    line = refusal(copy)
    assert f"{copy}" in line
    assert "251 features per frame, but the" in line and "reads 263" in line


def test_statistics_without_their_other_half(runs, tmp_path):
    config = vqvae_training(runs.data, tmp_path / "run")
    with pytest.raises(UserError, match=r"Std\.npy has no `mean` in its name"):
        train(dataclasses.replace(config, statistics=f"{runs.data / 'Std.npy'}"))
    assert not (tmp_path / "run").exists()


def test_data_that_are_not_there(refusal, tmp_path):
    assert f"{tmp_path / 'nowhere'}: no data set here" in refusal(tmp_path / "nowhere")


def test_devices_that_are_not_there(runs, tmp_path):
    config = dataclasses.replace(vqvae_training(runs.data, tmp_path / "run"), sharding=ShardingConfig(devices=1000))
    with pytest.raises(UserError, match=r"sharding\.devices: 1000, but there are"):
        train(config)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(("run", "says"), [("demo", "packaged model"), ("folder", "contains weights.safetensors and")])
def test_folders_that_are_models_do_not_become_runs(runs, tmp_path, monkeypatch, run, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "weights.safetensors").write_bytes(b"mine")
    with pytest.raises(UserError, match=says):
        train(vqvae_training(runs.data, Path(run)))
    assert not Path("demo").exists()
    assert [path.name for path in (tmp_path / "folder").iterdir()] == ["weights.safetensors"]


def test_a_folder_with_other_files_does_not_become_a_run(runs, tmp_path):
    """What is there would be written over: the statistics of a data set, a config of its user."""
    folder = shutil.copytree(runs.data, tmp_path / "data")
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(UserError, match=r"data: contains Mean\.npy and is no run; choose another --run"):
        train(vqvae_training(folder, folder))
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_an_interrupted_start_is_started_again(runs, tmp_path, monkeypatch):
    config = vqvae_training(runs.data, tmp_path / "run")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / ".DS_Store").touch()
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(experiment, "create_run", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
        train(config)
    assert (tmp_path / "run" / "Mean.npy").exists() and not is_run(tmp_path / "run")
    train(config)
    assert is_run(tmp_path / "run") and not (tmp_path / "run" / STARTED).exists()


def test_a_run_is_not_made_shorter(runs, tmp_path):
    config = vqvae_training(runs.data, tmp_path / "run")
    train(config)
    before = (tmp_path / "run" / "config.yaml").read_bytes()
    shorter = dataclasses.replace(config, loop=dataclasses.replace(config.loop, num_steps=config.loop.num_steps - 1))
    with pytest.raises(UserError, match=r"loop\.num_steps: \d+, but .* has made \d+ updates"):
        train(shorter, resume=True)
    assert (tmp_path / "run" / "config.yaml").read_bytes() == before


@pytest.mark.parametrize("stage", ["vqvae", "gpt"])
def test_data_of_another_frame_rate_are_refused(runs, tmp_path, stage):
    """Models show all motion at the rate of its skeleton."""
    folder = shutil.copytree(runs.data, tmp_path / "data")
    path = folder / "dataset.yaml"
    path.write_text(re.sub(r"fps: .*", "fps: 30.0", path.read_text()))
    run = tmp_path / "run"
    with pytest.raises(UserError, match=r"dataset\.yaml: fps: 30, but features of skeleton"):
        train(vqvae_training(folder, run) if stage == "vqvae" else gpt_training(folder, runs.vqvae, run))
    assert not run.exists()
