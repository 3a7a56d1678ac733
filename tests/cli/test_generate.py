"""`t2m generate`: files for sentences, one line for mistakes."""

import argparse
import json
import os
import re
import shutil

import jax
import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.cli import generate
from t2m_jax.cli.generate import add_arguments
from t2m_jax.cli.main import main
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.motion.changes import Changes
from t2m_jax.motion.formats import load_motion
from t2m_jax.records import fields_of
from t2m_jax.sampling import directing
from t2m_jax.sampling.model import ModelParts
from t2m_jax.sampling.request import MotionRequest
from tests.conftest import REPOSITORY
from tests.export.test_html import Elements


@pytest.mark.slow
def test_64_bits_of_the_environment_do_not_change_a_motion(bundle_folder, tmp_path, monkeypatch):
    command = ["generate", "a person walks", "--model", f"{bundle_folder}", "-o"]
    assert main([*command, f"{tmp_path / 'a.npz'}"]) == 0
    monkeypatch.setenv("JAX_ENABLE_X64", "1")
    jax.config.update("jax_enable_x64", True)
    try:
        assert main([*command, f"{tmp_path / 'b.npz'}"]) == 0
    finally:
        jax.config.update("jax_enable_x64", False)
    assert "JAX_ENABLE_X64" not in os.environ  # for the processes that a command starts
    one, other = (Motion.load(tmp_path / f"{name}.npz") for name in "ab")
    np.testing.assert_array_equal(one.positions, other.positions)


@pytest.mark.parametrize(
    ("prompt", "said"),
    [
        ("", "no words"),
        ("   \n", "no words"),
        ("?!", "no words"),
        ("a" * 10_000, "10,000 characters"),
        ("a person\x07 waves", "control character"),
        ("a person waves \N{WAVING HAND SIGN}", "emoji"),
    ],
)
def test_prompts_that_are_refused(refusal, bundle_folder, tmp_path, prompt, said):
    line = refusal("generate", prompt, "--model", bundle_folder, "-o", tmp_path / "out.npz")
    assert said in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["-o", "out.fbx"], ".fbx"),
        (["-o", "out"], "suffix"),
        (["-o", "no/such/folder/out.npz"], "does not exist"),
        (["--temperature", "-1", "-o", "out.npz"], "temperature"),
        (["--top-k", "0", "-o", "out.npz"], "top-k"),
        (["--top-p", "2", "-o", "out.npz"], "top-p"),
        (["--top-k", "3", "--top-p", "0.5", "-o", "out.npz"], "exclude"),
        (["--num-samples", "0", "-o", "out.npz"], "num-samples"),
        (["--num-samples", "300000000", "-o", "out.npz"], "num-samples: 300000000 is not a whole number from 1 to"),
        (["--seed", "-1", "-o", "out.npz"], "seed"),
    ],
)
def test_options_that_are_refused(refusal, bundle_folder, tmp_path, monkeypatch, options, said):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ModelParts, "sample_codes", lambda *_, **__: pytest.fail("began to generate"))
    assert said in refusal("generate", "a person walks", "--model", bundle_folder, *options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_sentences_in_turn_after_a_file(bundle_folder, tmp_path):
    command = ["generate", "--model", f"{bundle_folder}", "a person walks", "--then", "a person waves"]
    assert main([*command, "--seconds", "1.2", "--num-samples", "2", "-o", f"{tmp_path / 'a.npz'}"]) == 0
    first = load_motion(tmp_path / "a-0.npz")
    assert first.part_captions == ("a person walks", "a person waves") and first.num_frames == 48
    command = ["generate", "--model", f"{bundle_folder}", "a person runs", "--from", f"{tmp_path / 'a-1.npz'}"]
    assert main([*command, "-o", f"{tmp_path / 'b.npz'}"]) == 0
    longer = load_motion(tmp_path / "b.npz")
    assert longer.part_starts == (0, 24, 48)
    assert longer.part_captions == ("a person walks", "a person waves", "a person runs")


@pytest.mark.slow
def test_a_middle_and_variations_of_a_file(refusal, bundle_folder, tmp_path, capsys):
    start = tmp_path / "start.npz"
    Motion(make_motion("walk", seed=1, num_frames=60), 20.0, caption="a person walks").save(start)
    command = ["generate", "--model", f"{bundle_folder}", "a person waves", "--from", f"{start}"]
    assert main([*command, "--redo", "0.8:1.6", "--num-samples", "2", "-o", f"{tmp_path / 'redo.npz'}"]) == 0
    best = load_motion(tmp_path / "redo-0.npz")
    assert best.part_captions == ("a person walks", "a person waves", "a person walks") and best.num_frames == 60
    assert main([*command, "--vary", "0.5", "-o", f"{tmp_path / 'vary.npz'}"]) == 0
    assert load_motion(tmp_path / "vary.npz").caption == "a person waves"
    capsys.readouterr()
    said = "--redo: 1 to 9 s is not a part of the time from 0 to 3.0 s, where the motion ends"
    assert said in refusal(*command, "--redo", "1:9", "-o", f"{tmp_path / 'x.npz'}")
    assert not (tmp_path / "x.npz").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--then", ""], "no words"),
        (["a person runs", "--then", "a person waves"], "--then: follows one sentence, not 2"),
        (["--seconds", "-1"], "seconds: -1"),
        (["--from", "missing.npz"], "missing.npz"),
        (["--redo", "1:2"], "--redo: changes a motion; give it with --from"),
        (["--vary", "0.3"], "--vary: changes a motion; give it with --from"),
        (["--redo", "3:2", "--from", "{start}"], "--redo: 3 to 2 s ends before it begins"),
        (["--redo", "1-2"], "'1-2' is not BEGIN:END in seconds"),
        (["--redo", "1:2", "--from", "missing.npz"], "missing.npz"),
        (["--redo", "1:", "--from", "missing.npz"], "'1:' is not BEGIN:END in seconds"),
        (
            ["--redo", "1:2", "--from", "{start}", "--then", "a person waves"],
            "--redo: takes one sentence",
        ),
        (["--redo", "1:2", "--from", "{start}", "--vary", "0.5"], "--redo: excludes --vary"),
        (["--vary", "0.5", "--from", "{start}", "--at", "1", "root=0,0"], "leave out a variation"),
        (["--from", "{start}", "--at", "1", "root=0,0"], "leave out a motion to continue"),
        (["--redo", "1:2", "--from", "{start}", "--stop-rule", "sampled"], "--redo: excludes --stop-rule"),
        (["--vary", "0.5", "--from", "{start}", "--max-codes", "3"], "--vary: excludes --max-codes"),
        (["--seconds", "4", "--then", "a person waves", "--max-codes", "3"], "--seconds: excludes --max-codes"),
        (["--raw", "--clean"], "--raw: excludes --clean"),
        (["--vary", "1.5", "--from", "{start}"], "--vary: 1.5 is not a number from 0 to 1"),
        (
            ["--candidates", "0", "--redo", "1:2", "--from", "{start}"],
            "--candidates: 0 is not a whole number",
        ),
    ],
)
def test_chains_that_are_refused(refusal, bundle_folder, tmp_path, tmp_path_factory, monkeypatch, options, said):
    start = tmp_path_factory.mktemp("start") / "start.npz"
    Motion(make_motion("walk", seed=1, num_frames=60), 20.0).save(start)
    options = [option.format(start=start) for option in options]
    monkeypatch.chdir(tmp_path)
    assert said in refusal("generate", "a person walks", *options, "--model", bundle_folder, "-o", "out.npz")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--at", "1", "nose=0,1,0"], "--at: nose at 1 s: no such joint; known: pelvis"),
        (["--at", "soon", "head=0,1,0"], "--at: 'soon head=0,1,0' is not TIME JOINT=X,Y,Z"),
        (["--at", "1", "head=0,9,0"], "--at: head at 1 s: nobody reaches a height of 9 m"),
        (["--at", "1", "head=0,1.5,0 exact"], "--at: head at 1 s: cannot be exact; these can: root, "),
        (["--at", "0.5", "root=0,3"], "--at: root at 0.5 s: 3 m in 0.5 s is faster than 5 m/s"),
        (["--pose", "soon", "missing.npz"], "--pose soon missing.npz: 'soon' is not a number of seconds"),
        (["--pose", "1", "missing.npz"], "missing.npz"),
        (["--pose", "1", "missing.npz exact"], "missing.npz: "),
        (["--at", "1", "root=0,0", "--then", "a person waves"], "a span to redo; leave out a second sentence"),
        (
            ["--at", "1", "root=0,0", "--seconds", "2"],
            "--at: targets are for a new motion of one sentence, or a span to redo;",
        ),
        (["--at", "900", "root=0,0"], "--at: root at 900 s: the longest motion for a sentence has"),
    ],
)
def test_targets_that_are_refused(refusal, bundle_folder, tmp_path, monkeypatch, options, said):
    monkeypatch.chdir(tmp_path)
    assert said in refusal("generate", "a person walks", *options, "--model", bundle_folder, "-o", "out.npz")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_distances_to_targets_are_said(bundle_folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(directing, "ROUNDS", 1)
    file = tmp_path / "out.npz"
    command = ["generate", "a person walks", "--model", f"{bundle_folder}", "--candidates", "2", "-o", f"{file}"]
    assert main([*command, "--at", "0", "root=0,0", "--at", "0.3:0.4", "left_wrist=0.9,2,0.4"]) == 0
    said = capsys.readouterr().err
    assert "t2m: root at 0 s: met, 0." in said and "t2m: left_wrist at 0.3 to 0.4 s: missed, " in said
    assert main([*command, "--pose", "0.1", f"{file} exact"]) == 0
    assert "t2m: pose at 0.1 s: met, 0.00" in capsys.readouterr().err


def test_every_field_of_the_records_is_an_option():
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    options = {action.dest for action in parser._actions}
    fields = {field.name for record in (MotionRequest, Changes) for field in fields_of(record)}
    assert fields - options == {"captions", "strategy", "targets", "begin", "end"}  # other options, or only in Python
    files = {"at", "pose", "names", "units", "root_bone", "camera", "output", "rig", "up", "character"}
    assert options - fields == {"text", "then", "trim", "help", "model"} | files


def test_a_folder_in_the_place_of_the_file_is_refused(refusal, bundle_folder, tmp_path):
    (tmp_path / "out.npz").mkdir()
    line = refusal("generate", "a person walks", "--model", bundle_folder, "-o", tmp_path / "out.npz")
    assert "cannot be written" in line


@pytest.mark.skipif(os.name == "nt", reason="uses pipes of POSIX")
def test_a_pipe_in_the_place_of_the_file_is_refused_and_kept(refusal, bundle_folder, tmp_path):
    pipe = tmp_path / "out.npz"
    os.mkfifo(pipe)
    line = refusal("generate", "a person walks", "--model", bundle_folder, "-o", pipe)
    assert f"{pipe}: cannot be written, it is a pipe or device" in line
    assert list(tmp_path.iterdir()) == [pipe] and pipe.is_fifo()


def test_models_that_are_refused(refusal, bundle_folder, tmp_path):
    output = tmp_path / "out.npz"
    assert "no such model" in refusal("generate", "a person walks", "--model", tmp_path / "nothing", "-o", output)
    for name in ("bundle.yaml", "weights.safetensors", "Mean.npy", "tokenizer.json"):
        broken = tmp_path / f"without-{name}"
        shutil.copytree(bundle_folder, broken)
        (broken / name).unlink()
        assert name in refusal("generate", "a person walks", "--model", broken, "-o", output)
    (broken / "tokenizer.json").write_text("{}")
    assert "tokenizer.json" in refusal("generate", "a person walks", "--model", broken, "-o", output)
    assert not output.exists()


def test_every_format_is_written(bundle_folder, tmp_path, capsys):
    outputs = [tmp_path / f"walk.{suffix}" for suffix in ("npz", "bvh", "html", "gif")]
    options = [option for output in outputs for option in ("-o", f"{output}")]
    assert main(["generate", "a person walks", "--model", f"{bundle_folder}", "--seed", "7", *options]) == 0
    assert capsys.readouterr().out.split() == [f"{output}" for output in outputs]
    arrays = np.load(outputs[0])
    assert {"positions", "features", "codes", "fps", "caption", "seed"} <= set(arrays)
    assert (str(arrays["caption"]), int(arrays["seed"]), float(arrays["fps"])) == ("a person walks", 7, 20.0)
    assert len(arrays["positions"]) == 4 * len(arrays["codes"]) == len(arrays["features"])
    read_back = load_motion(outputs[1])
    assert read_back.num_frames == len(arrays["positions"])


@pytest.mark.parametrize("words", [["a", "person", "walks"], ["walk.", "run"], ["a", "person's", "4", "steps."]])
def test_sentences_of_one_word_each_may_lack_their_quotes(refusal, bundle_folder, tmp_path, words):
    line = refusal("generate", *words, "--model", bundle_folder, "-o", tmp_path / "out.npz")
    assert f"{len(words)} sentences of one word each; for one sentence, use quotes: t2m generate" in line
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_sentences_of_one_word_each_may_end_with_periods(bundle_folder, tmp_path, capsys):
    assert main(["generate", "walk.", "run!", "--model", f"{bundle_folder}", "-o", f"{tmp_path / 'out.npz'}"]) == 0
    assert len(capsys.readouterr().out.split()) == 2


@pytest.mark.slow
def test_what_the_model_does_not_know_is_one_line_and_in_the_file(tmp_path, capsys):
    """The line is the one that the README shows."""
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    prompt, shown = re.search(r'\$ t2m generate "(.*?)"\n(.*?)```', readme, re.DOTALL).groups()
    output = tmp_path / "out.npz"
    sentences = [prompt, "a person walks"]
    assert main(["generate", *sentences, "--num-samples", "2", "--raw", "-o", f"{output}"]) == 0
    warnings = [line for line in capsys.readouterr().err.splitlines() if line.startswith("t2m: warning: ")]
    (line,) = warnings
    assert line == " ".join(shown.split())
    for number, (warning, words) in enumerate([(line[14:], ("swims", "north"))] * 2 + [("", ())] * 2):
        motion = load_motion(tmp_path / f"out-{number}.npz")
        assert (motion.warning, motion.unknown_words) == (warning, words)


def test_what_a_motion_misses_is_said_once(bundle_folder, tmp_path, capsys):
    output = tmp_path / "out.npz"
    command = ["generate", "a person kicks nineteen times", "--model", f"{bundle_folder}", "-o", f"{output}"]
    assert main(command) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("t2m: warning: ")]
    assert len([line for line in lines if re.search(r"kick is counted \d+ times; try another seed", line)]) == 1
    assert all(line.removeprefix("t2m: warning: ") in load_motion(output).warning for line in lines)


def test_of_several_motions_it_is_said_which_one_misses_something(capsys):
    motions = [Motion(np.zeros((2, 22, 3), np.float32), 20.0, warning=text) for text in ("known A", "A", "", "A")]
    assert len(list(generate._show_misses(iter(motions), ["known"], count=4))) == 4
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f"t2m: warning: motion {number}: A" for number in (0, 1, 3)]


def test_several_motions_are_numbered(bundle_folder, tmp_path, capsys):
    output = tmp_path / "many.npz"
    texts = ["a person walks", "someone waves"]
    assert main(["generate", *texts, "--model", f"{bundle_folder}", "--num-samples", "2", "-o", f"{output}"]) == 0
    names = [f"many-{number}.npz" for number in range(4)]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    captions = [str(np.load(tmp_path / name)["caption"]) for name in names]
    assert captions == [texts[0], texts[0], texts[1], texts[1]]
    capsys.readouterr()


def test_several_motions_share_a_page(bundle_folder, tmp_path, monkeypatch):
    options = ["--model", f"{bundle_folder}", "--num-samples", "3", "-o", f"{tmp_path / 'many.html'}"]
    assert main(["generate", "a person walks", *options, "-o", f"{tmp_path / 'many.bvh'}"]) == 0
    assert num_figures(tmp_path / "many.html") == 3
    monkeypatch.setattr("t2m_jax.cli.generate.MAX_ON_PAGE", 2)
    assert main(["generate", "a person walks", *options]) == 0
    assert [num_figures(path) for path in sorted(tmp_path.glob("many-*.html"))] == [2, 1]


def num_figures(path) -> int:
    return len(json.loads(Elements(path.read_text()).data)["figures"])


@pytest.mark.slow
def test_files_are_written_before_the_next_motions_are_generated(bundle_folder, tmp_path, monkeypatch):
    counts, sample_codes = [], ModelParts.sample_codes

    def record(*args, **kwargs):
        counts.append(len(list(tmp_path.glob("*.npz"))))
        return sample_codes(*args, **kwargs)

    monkeypatch.setattr(ModelParts, "sample_codes", record)
    monkeypatch.setattr("t2m_jax.sampling.generation.MAX_BATCH", 2)
    options = ["--model", f"{bundle_folder}", "--num-samples", "5", "--raw", "-o", f"{tmp_path / 'walk.npz'}"]
    assert main(["generate", "a person walks", *options]) == 0
    assert counts == [0, 2, 4] and len(list(tmp_path.glob("*.npz"))) == 5


def test_same_seed_same_files(bundle_folder, tmp_path):
    for name in ("one.npz", "two.npz"):
        assert main(["generate", "a person walks", "--model", f"{bundle_folder}", "-o", f"{tmp_path / name}"]) == 0
    one, two = np.load(tmp_path / "one.npz"), np.load(tmp_path / "two.npz")
    np.testing.assert_array_equal(one["codes"], two["codes"])
    np.testing.assert_array_equal(one["positions"], two["positions"])


def test_changes_that_move_a_motion_away_from_its_targets_have_names():
    assert generate._changed(Changes(mirror=True, speed=2.0, fps=30.0, clean=True)) == "--mirror, --speed"
    assert generate._changed(Changes(begin=1.0, end=2.0, path=((0.0, 0.0), (1.0, 1.0)))) == "--trim, --path"
    assert not generate._changed(Changes(fps=30.0, clean=True))
