"""What is intact in the folder of a model, and what is not."""

import json
import shutil

import pytest

from t2m_jax.bench import save_report as save_bench_report
from t2m_jax.checkpoints.audit import audit_model, is_model_folder
from t2m_jax.checkpoints.bundle import save_bundle
from t2m_jax.checkpoints.evaluator import save_evaluator
from t2m_jax.cli.main import main
from t2m_jax.data.importers.synthetic import write_synthetic_dataset
from t2m_jax.errors import UserError
from t2m_jax.files.manifest import CHECKSUM, MANIFEST
from t2m_jax.files.reading import load_json
from t2m_jax.files.writing import save_json
from t2m_jax.train import train
from tests.bench.conftest import report as bench_report
from tests.conftest import REPOSITORY
from tests.tiny import LOOP, random_bundle, random_evaluator, vqvae_training


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """A bundle, an evaluator, a data set and a run on it."""
    folder = tmp_path_factory.mktemp("models")
    save_bundle(folder / "bundle", random_bundle(), card="# tiny\n")
    save_evaluator(folder / "evaluator", random_evaluator())
    write_synthetic_dataset(folder / "data", num_clips=20, seed=3)
    train(vqvae_training(folder / "data", folder / "run", loop=LOOP))
    return folder


@pytest.fixture
def copy(models, tmp_path):
    """A copy of the models, which may be changed."""
    return shutil.copytree(models, tmp_path / "models")


def flip(path):
    whole = path.read_bytes()
    path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))


def problems(path):
    return {part.name: part.problem for part in audit_model(path) if part.problem}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bundle", "evaluator", "run"])
def test_sound_models_are_intact(models, name, capsys):
    assert is_model_folder(models / name) and not problems(models / name)
    assert main(["check", f"{models / name}"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) >= 2 and all(line.endswith(": intact") for line in lines)


@pytest.mark.slow
def test_each_damaged_part_of_a_run_is_named(copy, capsys):
    run = copy / "run"
    oldest, newest = sorted((run / "checkpoints").iterdir(), key=lambda path: int(path.name))
    (best,) = (run / "best").iterdir()
    flip(newest / "_CHECKPOINT_METADATA")
    flip(best / "weights.safetensors")
    found = problems(run)
    assert set(found) == {f"checkpoint {newest.name}", f"best weights of step {best.name}", "model"}
    assert f"{newest / '_CHECKPOINT_METADATA'}" in found[f"checkpoint {newest.name}"]
    assert main(["check", f"{run}"]) == 1
    assert f"checkpoint {oldest.name}: intact\n" in capsys.readouterr().out


@pytest.mark.slow
def test_a_run_whose_description_is_damaged_is_read_no_further(copy):
    (copy / "run" / "run.yaml").write_text("kind: [")
    (part,) = audit_model(copy / "run")
    assert part.name == "run.yaml" and "cannot read this YAML" in part.problem


@pytest.mark.slow
def test_damage_of_a_bundle_shows(copy):
    flip(copy / "bundle" / "README.md")
    assert "README.md: has changed since it was written" in problems(copy / "bundle")["bundle"]


def test_a_bundle_without_checksums_is_not_intact(copy, capsys):
    (copy / "bundle" / MANIFEST).unlink()
    assert main(["check", f"{copy / 'bundle'}"]) == 1
    assert "manifest.txt: there is no such file" in capsys.readouterr().out


def test_packaged_models_and_evaluators_have_names(capsys):
    assert [main(["check", name]) for name in ("demo-free", "benchmark-free")] == [0, 0]
    assert capsys.readouterr().out.count(": intact") >= 4


def test_data_sets_and_other_paths(models, capsys, tmp_path):
    assert main(["check", f"{models / 'data'}"]) == 0
    assert "no problems found" in capsys.readouterr().out
    assert main(["check", f"{models / 'nothing'}"]) == 2
    assert "there is no such file or folder" in capsys.readouterr().err
    (tmp_path / "walk.BVH").touch()
    assert main(["check", f"{tmp_path / 'walk.BVH'}"]) == 2
    assert "walk.BVH: is a file of motions, which has no checksum" in capsys.readouterr().err
    assert main(["check", f"{models}"]) == 2
    assert main(["check", "demo"]) == 0
    with pytest.raises(UserError, match="neither a run, a bundle nor an evaluator"):
        audit_model(models)


LEGACY = REPOSITORY / "tests" / "legacy" / "reports"
"""Reports as version 0.2 wrote them at its start."""


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("generation", "a report of `t2m evaluate generation` on 32 motions"),
        ("reconstruction", "a report of `t2m evaluate reconstruction` on 32 clips"),
        ("prompts", "a report of `t2m evaluate prompts --group actions` on 11 motions"),
    ],
)
def test_reports_are_recognized(name, said, tmp_path, capsys):
    assert main(["check", f"{LEGACY / f'{name}.json'}"]) == 0
    assert capsys.readouterr().out == f"{LEGACY / f'{name}.json'}: intact, {said}\n"


def test_reports_of_benchmarks_and_with_an_evaluator_are_recognized(tmp_path, capsys):
    path = tmp_path / "report.json"
    save_bench_report(path, bench_report())
    assert main(["check", f"{path}"]) == 0
    assert capsys.readouterr().out == f"{path}: intact, a report of `t2m bench` (rows: 1)\n"
    found = load_json(LEGACY / "generation.json")
    save_json(path, found | {"rows": {"real": found["rows"]["real"], "reconstruction": found["rows"]["generated"]}})
    assert main(["check", f"{path}"]) == 0
    assert "a report of `t2m evaluate reconstruction` with an evaluator, on " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("generation", {"rows": {"real": {}}}, "is not a report with the metrics of an evaluator"),
        ("reconstruction", {"num_clips": "4"}, "num_clips: expected a whole number"),
        ("reconstruction", {"mpjpe_mm": None}, "is not a report with the figures of a tokenizer"),
        ("prompts", {"contents": 3}, "is not a report with the counts of prompts"),
        ("prompts", {"contents": {}}, "contents: there are no motions"),
        ("prompts", {"contents": {"run": 3}}, "is not a report with the counts of prompts"),
        (
            "prompts",
            {"contents": {"run": {"right": 2, "samples": 1, "failures": [], "instead": {}}}},
            "2 of 1 are right",
        ),
        (
            "prompts",
            {"contents": {"run": {"right": 1, "samples": 1, "failures": [], "instead": 3}}},
            "counts of prompts",
        ),
        ("prompts", {"num_samples": 9}, "num_samples: does not fit the contents"),
        ("prompts", {"prompt_following": 0.5}, "prompt_following: does not fit the contents"),
        ("prompts", {"group": "\x1b[31m"}, "cannot be printed"),
        ("bench", {"rows": 3}, "rows: expected a list"),
        ("bench", {"format_version": 2}, "is not a benchmark report of format_version 1"),
    ],
)
def test_damaged_reports_are_one_line(name, change, said, tmp_path, capsys):
    path = tmp_path / "report.json"
    if name == "bench":
        save_bench_report(path, bench_report())
    else:
        shutil.copy(LEGACY / f"{name}.json", path)
    data = load_json(path) | change
    data.pop(CHECKSUM, None)  # as in files of older versions
    path.write_text(json.dumps(data))
    assert main(["check", f"{path}"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"t2m: error: {path}: ") and said in line and line.isprintable()


@pytest.mark.parametrize(
    ("content", "said"), [("{}", "is not a report; give"), ("[]", "is not a report; give"), ('{"rows": ', "as JSON")]
)
def test_other_files_are_one_line(content, said, tmp_path, capsys):
    (tmp_path / "report.json").write_text(content)
    assert main(["check", f"{tmp_path / 'report.json'}"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
