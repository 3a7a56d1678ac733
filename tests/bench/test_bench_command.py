"""`t2m bench`: every sub-command prints a table and writes a report."""

import subprocess
import sys
from pathlib import Path

import pytest

from t2m_jax import bench
from t2m_jax.bench import data as data_module
from t2m_jax.bench import evaluate as evaluate_module
from t2m_jax.bench import sample as sample_module
from t2m_jax.bench import train as train_module
from t2m_jax.cli.main import main
from t2m_jax.models import evaluator as evaluator_module
from t2m_jax.train import LoopConfig
from tests import tiny
from tests.conftest import REPOSITORY


def tiny_training(kind, size="full", *, batch=None, **_):
    assert batch in (None, 4)
    if kind == "vqvae":
        return tiny.vqvae_training(Path(), Path(), loop=LoopConfig(batch_size=4))
    return tiny.gpt_training(Path(), Path(), Path(), loop=LoopConfig(batch_size=4))


@pytest.fixture
def tiny_models(monkeypatch):
    monkeypatch.setattr(train_module, "make_training", tiny_training)
    monkeypatch.setattr(evaluate_module, "BATCH", 2)
    monkeypatch.setattr(data_module, "BATCH", 2)
    monkeypatch.setattr(sample_module, "NUM_CODES", 8)
    sizes = {"gpt": tiny.GPT, "hifigpt": tiny.HIFIGPT, "vqvae": tiny.VQVAE, "rvqvae": tiny.RVQVAE}
    monkeypatch.setattr(sample_module, "published_config", sizes.get)
    monkeypatch.setattr(evaluator_module, "EvaluatorConfig", lambda: tiny.EVALUATOR)


@pytest.mark.slow
@pytest.mark.release
@pytest.mark.parametrize(
    ("arguments", "count"),
    [
        (["train", "--batch", "4"], 2),
        (["train", "--kind", "vqvae", "--devices", "1"], 1),
        (["sample", "--model", "MODEL", "--batch", "1", "2"], 2),
        (["evaluate"], 2),
        (["data", "--data", "DATA"], 2),
        (["sample", "--full-size", "--batch", "2"], 3),
        pytest.param(["all"], 11, marks=pytest.mark.release),
    ],
)
def test_measurements_are_printed_and_stored(
    tiny_models, bundle_folder, data_folder, tmp_path, capsys, arguments, count
):
    path = tmp_path / "report.json"
    places = {"MODEL": f"{bundle_folder}", "DATA": f"{data_folder}"}
    arguments = ["bench", *(places.get(word, word) for word in arguments)]
    assert main([*arguments, "--json", f"{path}"]) == 0
    printed, report = capsys.readouterr(), bench.load_report(path)
    assert len(report.rows) == count
    assert all(f"| {row.name} " in printed.out for row in report.rows)
    assert "measured peak" in printed.out
    assert printed.err.splitlines()[-1].startswith("next: t2m bench ")


@pytest.mark.release
def test_virtual_devices_share_the_work(bundle_folder, tmp_path):
    """In a process of its own, because the number of devices cannot change later."""
    command = [sys.executable, "-m", "tests.bench.several_devices", f"{bundle_folder}", f"{tmp_path}"]
    result = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    reports = {name: bench.load_report(tmp_path / f"{name}.json") for name in ("train", "sample", "data")}
    one, two = reports["train"].rows
    assert two.name == f"{one.name}, 2 devices"
    assert two["first loss"].value == pytest.approx(one["first loss"].value, rel=1e-5)
    assert [peaks.num_devices for peaks in reports["train"].machine.peaks] == [1, 2]
    assert [row.name.partition("batch 2")[2] for row in reports["sample"].rows] == ["", ", 2 devices"]
    assert [row.name for row in reports["data"].rows] == ["windows, 4x64", "windows, 4x64, 2 devices"]
    assert "--devices 4, but there are 2" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("train --batch 0", "--batch: 0 is not a whole number above 0"),
        ("train --steps-per-call 2", "unknown argument '--steps-per-call'"),
        ("evaluate --devices 0", "--devices: 0 is not"),
        ("data --devices 100", "--devices 100, but there are"),
        ("data --data no-such-folder", "no-such-folder"),
        ("data --json no-such-folder/x.json", "no-such-folder"),
        ("walk", "invalid choice: 'walk'"),
    ],
)
def test_bad_options_give_one_line(refusal, arguments, message):
    assert message in refusal("bench", *arguments.split())
