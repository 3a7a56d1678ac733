"""Each command ends by saying what to run next, on standard error, so that its output stays easy to parse."""

import shlex

import pytest

from t2m_jax.cli.main import main


@pytest.fixture
def motion(bundle_folder, tmp_path, capsys):
    path = tmp_path / "a walk.npz"
    assert main(["generate", "a person walks", "--model", f"{bundle_folder}", "-o", f"{path}"]) == 0
    assert next_step(capsys) == ["t2m", "view", f"{path}", "-o", "motion.html"]
    return path


def next_step(capsys) -> list[str]:
    """Returns the words of the command that the last line of standard error names."""
    said = capsys.readouterr()
    assert "next:" not in said.out
    word, _, command = said.err.splitlines()[-1].partition(" ")
    assert word == "next:"
    return shlex.split(command)


@pytest.mark.slow
def test_generated_motion_is_viewed(motion, tmp_path, monkeypatch, capsys):
    """The suggested command works, also for a name with a space."""
    monkeypatch.chdir(tmp_path)
    assert main(["view", f"{motion}", "-o", "motion.html"]) == 0
    assert next_step(capsys) == ["open", "motion.html", "in", "a", "browser"]
    assert main(["view", f"{motion}", "-o", "walk.bvh"]) == 0
    assert main(next_step(capsys)[1:]) == 0


@pytest.mark.slow
def test_a_page_is_opened(bundle_folder, tmp_path, capsys):
    outputs = ["-o", f"{tmp_path / 'walk.bvh'}", "-o", f"{tmp_path / 'walk.html'}"]
    options = ["--model", f"{bundle_folder}", "--num-samples", "2", *outputs]
    assert main(["generate", "a person walks", *options]) == 0
    _, page, *_ = next_step(capsys)
    assert page == f"{tmp_path / 'walk.html'}" and (tmp_path / "walk.html").is_file()


@pytest.mark.slow
def test_a_video_is_opened(bundle_folder, tmp_path, capsys):
    path = tmp_path / "a walk.gif"
    assert main(["generate", "a person walks", "--model", f"{bundle_folder}", "-o", f"{path}"]) == 0
    assert next_step(capsys) == ["open", f"{path}"]
