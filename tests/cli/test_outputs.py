"""The files of all commands: what will be replaced is said before, and no other process writes it at once."""

import json
import logging
from pathlib import Path

import pytest
from filelock import FileLock

from t2m_jax import bench
from t2m_jax.bench import probes
from t2m_jax.cli import bench as bench_command
from t2m_jax.cli.main import main
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling import TextToMotion
from tests.bench.conftest import report


@pytest.fixture
def replaced(caplog):
    """Returns a function that gives the names of the files which, as was just said, will be replaced."""
    caplog.set_level(logging.INFO, logger="t2m_jax")

    def names():
        lines = [line for line in caplog.messages if line.endswith(": exists and will be replaced")]
        caplog.clear()
        return [Path(line.rpartition(":")[0]).name for line in lines]

    return names


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "existing", "expected"),
    [
        ([], ["a.npz", "a-0.npz"], ["a.npz"]),
        (["--num-samples", "3"], ["a.npz", "a-0.npz", "a-2.npz"], ["a-0.npz", "a-2.npz"]),
        (["--num-samples", "2"], ["a.npz"], []),
    ],
)
def test_generate_names_the_files_that_it_replaces(bundle_folder, tmp_path, replaced, options, existing, expected):
    for name in existing:
        (tmp_path / name).write_text("mine")
    arguments = ["generate", "a person walks", "--model", f"{bundle_folder}", "-o", f"{tmp_path / 'a.npz'}"]
    assert main([*arguments, *options]) == 0
    assert replaced() == expected
    kept = [path.name for path in sorted(tmp_path.iterdir()) if path.read_bytes() == b"mine"]
    assert kept == sorted(set(existing) - set(expected))


def test_what_stays_is_not_said_to_be_replaced(refusal, bundle_folder, tmp_path, replaced):
    kept, walk = tmp_path / "kept.npz", tmp_path / "walk.npz"
    Motion(make_motion("walk", seed=1, num_frames=60), 20.0).save(walk)
    kept.write_text("mine")
    refusal("view", walk, "-o", kept, "--trim", "50:")
    command = ["generate", "a person waves", "--model", bundle_folder, "--from", walk, "-o", kept]
    refusal(*command, "--redo", "5:99")
    assert replaced() == [] and kept.read_text() == "mine"
    assert main(["view", f"{walk}", "-o", f"{kept}", "--trim", "1:"]) == 0
    assert replaced() == ["kept.npz"]


@pytest.mark.slow
def test_generate_holds_the_locks_of_what_it_writes(bundle_folder, tmp_path, monkeypatch):
    locks, generate = [], TextToMotion.make

    def watched(*args, **options):
        for motion in generate(*args, **options):
            locks.append(sorted(path.name for path in tmp_path.glob(".*.lock")))
            yield motion

    monkeypatch.setattr(TextToMotion, "make", watched)
    arguments = ["generate", "a person walks", "--model", f"{bundle_folder}", "--num-samples", "2"]
    assert main([*arguments, "-o", f"{tmp_path / 'a.npz'}", "-o", f"{tmp_path / 'b.bvh'}"]) == 0
    assert locks == [[".a-0.npz.lock", ".b-0.bvh.lock"]] * 2
    assert not list(tmp_path.glob(".*"))


def test_generate_does_not_write_what_another_process_writes(bundle_folder, tmp_path, capsys):
    arguments = ["generate", "a person walks", "--model", f"{bundle_folder}", "--num-samples", "2"]
    with FileLock(tmp_path / ".a-1.npz.lock"):  # another lock than that of the package, as in another process
        (tmp_path / ".a-1.npz.lock").write_text("123\nelsewhere\n")
        assert main([*arguments, "-o", f"{tmp_path / 'a.npz'}"]) == 2
    assert "a-1.npz: is being written by process 123 on elsewhere" in capsys.readouterr().err
    assert not (tmp_path / "a-1.npz").exists()


@pytest.mark.slow
def test_the_audit_of_data_names_the_file_that_it_replaces(data_folder, tmp_path, replaced):
    path = tmp_path / "report.json"
    for expected in ([], ["report.json"]):
        assert main(["data", "check", f"{data_folder}", "--json", f"{path}"]) == 0
        assert replaced() == expected
        assert json.loads(path.read_text())["problems"] == []


def test_a_benchmark_names_the_file_that_it_replaces(tmp_path, monkeypatch, replaced):
    path = tmp_path / "report.json"

    def measured(*_, **__):
        assert (tmp_path / ".report.json.lock").exists()
        return report()

    monkeypatch.setattr(probes, "make_report", measured)
    monkeypatch.setattr(bench_command, "_use_devices", lambda counts: [1])
    for expected in ([], ["report.json"]):
        assert main(["bench", "data", "--json", f"{path}"]) == 0
        assert replaced() == expected
        assert bench.load_report(path) == report()
