"""Files that version 0.1 wrote: today's code reads them and computes the same from them. See README.md."""

import csv
import json
import shutil
import tarfile
from pathlib import Path

import numpy as np
import pytest

from t2m_jax.checkpoints.best import find_best
from t2m_jax.checkpoints.run import FORMAT_VERSION, run_info
from t2m_jax.cli.main import main
from t2m_jax.data import write_synthetic_dataset

SAMPLES = Path(__file__).parent
RUNS = ("vqvae", "gpt", "evaluator")
EXPECTED = json.loads((SAMPLES / "expected.json").read_text(encoding="utf-8"))


@pytest.fixture
def samples(tmp_path, monkeypatch):
    """Returns a folder with a copy of each sample, which is also the working directory."""
    for name in RUNS:
        with tarfile.open(SAMPLES / f"{name}.tar.gz") as archive:
            archive.extraction_filter = getattr(tarfile, "data_filter", None)  # not in Python before 3.11.4
            archive.extractall(tmp_path)
    shutil.copytree(SAMPLES / "bundle", tmp_path / "bundle")
    shutil.copytree(SAMPLES / "reports", tmp_path / "reports")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("T2M_JAX_NO_COMPILATION_CACHE", "1")
    return tmp_path


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """The data the samples were trained on."""
    folder = tmp_path_factory.mktemp("legacy") / "data"
    write_synthetic_dataset(folder, num_clips=20, seed=3)
    # Captions are written in more ways today.
    for name, text in json.loads((SAMPLES / "texts.json").read_text(encoding="utf-8")).items():
        (folder / "texts" / name).write_text(text, encoding="utf-8")
    for split in ("val", "test"):
        shutil.copyfile(folder / "train.txt", folder / f"{split}.txt")
    return folder


@pytest.fixture
def samples_with_data(samples, dataset):
    """Returns the folder of the samples, with the data where the configs expect it."""
    shutil.copytree(dataset, samples / "data")
    return samples


def run_command(*arguments) -> None:
    assert main([f"{argument}" for argument in arguments]) == 0


def generated(folder: Path, model: str, prompts: list[str], seed: int) -> list[np.lib.npyio.NpzFile]:
    """Returns the files that `t2m generate` writes, one for each prompt."""
    output = folder / f"{model}-generated"
    output.mkdir()
    run_command("generate", *prompts, "--model", model, "--seed", seed, "-o", output / "motion.npz")
    return [np.load(path) for path in sorted(output.iterdir())]


def assert_codes(folder: Path, model: str, expected: list[list[int]]) -> None:
    motions = generated(folder, model, EXPECTED["prompts"], EXPECTED["seed"])
    assert [motion["codes"].tolist() for motion in motions] == expected


@pytest.mark.parametrize("model", ["gpt", "bundle"])
def test_a_run_and_a_bundle_generate_the_same_codes(samples, model):
    assert_codes(samples, model, EXPECTED["codes_of_the_best_weights"])


def test_the_newest_checkpoint_is_loaded_if_no_weights_are_the_best(samples):
    (samples / "gpt" / "best.yaml").unlink()
    assert_codes(samples, "gpt", EXPECTED["codes_of_the_newest_weights"])


@pytest.mark.parametrize(
    ("run", "expected"),
    [
        ("vqvae", {"step": 3, "metric": "r_precision_1", "value": 0.03125, "sampling": None}),
        ("gpt", {"step": 3, "metric": "fid", "value": 2.0983762741088867, "sampling": "sampled"}),
        ("evaluator", {"step": 6, "metric": "loss", "value": 50.112091064453125, "evaluator": None}),
    ],
)
def test_best_weights_are_read_in_both_formats(samples, run, expected):
    best = find_best(samples / run)
    assert {name: getattr(best, name) for name in expected} == expected


@pytest.mark.parametrize("with_config", [True, False], ids=["config", "run alone"])
@pytest.mark.parametrize("stage", RUNS)
def test_a_run_is_not_resumed_because_its_updates_were_different(samples_with_data, capsys, stage, with_config):
    run, config = samples_with_data / stage, samples_with_data / f"{stage}.yaml"
    shutil.copyfile(run / "config.yaml", config)
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    given = [config] if with_config else ["--run", stage]
    assert main(["train", stage, *map(str, given), "--resume", "--loop.num_steps", "12"]) != 0
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(
        f"{stage}: was started with an older t2m_jax, whose updates were different; use it as it is, or start a new "
        f"run from its weights with `--init {stage}`"
    )
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


@pytest.mark.slow
@pytest.mark.parametrize("stage", RUNS)
def test_a_new_run_starts_from_the_weights_of_an_old_one(samples_with_data, stage):
    config = samples_with_data / f"{stage}.yaml"
    shutil.copyfile(samples_with_data / stage / "config.yaml", config)
    run_command("train", stage, config, "--run", "new", "--init", stage, "--loop.num_steps", 2)
    assert run_info(samples_with_data / "new").format_version == FORMAT_VERSION
    with (samples_with_data / "new" / "train.csv").open(encoding="utf-8") as file:
        assert all(np.isfinite(float(row["loss"])) for row in csv.DictReader(file))


def test_a_run_reconstructs_as_its_report_says(samples_with_data):
    run_command("evaluate", "reconstruction", "--model", "vqvae", "--data", "data", "--json", "new.json")
    paths = (Path("reports/reconstruction.json"), Path("new.json"))
    old, new = (json.loads(path.read_text(encoding="utf-8")) for path in paths)
    assert old.pop("split") == new["split"] == "test"
    assert {name: new[name] for name in old} == pytest.approx(old, rel=1e-3)


def values(report: Path) -> dict[tuple[str, str], list[float]]:
    """Returns the values of each repeat of a report of `t2m evaluate generation`, by row and metric."""
    rows = json.loads(report.read_text(encoding="utf-8"))["rows"]
    return {(row, name): value["repeats"] for row, metrics in rows.items() for name, value in metrics.items()}


def test_an_evaluation_with_the_evaluator_gives_the_report(samples_with_data):
    arguments = ("--model", "gpt", "--data", "data", "--evaluator", "evaluator", "--num-repeats", 2)
    run_command("evaluate", "generation", *arguments, "--json", "new.json")
    old, new = values(Path("reports/generation.json")), values(Path("new.json"))
    assert len(old) == 28
    for name in old:
        np.testing.assert_allclose(new[name], old[name], rtol=1e-3, atol=1e-4, err_msg=f"{name}")


def test_a_report_is_read(samples, capsys):
    run_command("evaluate", "table", "reports/generation.json")
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("generation")]
    assert "0.094 ± .000  2.072 ± .055  4.993 ± .001  0.319 ± .045  0.313 ± .001" in line
