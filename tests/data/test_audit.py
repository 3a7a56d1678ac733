import dataclasses
import json
import shutil

import numpy as np
import pytest

from t2m_jax.cli import data as cli
from t2m_jax.cli.main import main
from t2m_jax.data.audit import audit_dataset
from t2m_jax.data.captioning.captions import CAPTIONS
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.humanml3d import import_humanml3d
from t2m_jax.data.index import IndexEntry, save_index
from t2m_jax.data.writer import new_folder
from t2m_jax.errors import UserError
from t2m_jax.files.manifest import MANIFEST, has_manifest


@pytest.fixture
def folder(synthetic_folder, tmp_path):
    """A copy that a test may break. Its manifest would name every change."""
    copy = shutil.copytree(synthetic_folder, tmp_path / "data")
    (copy / MANIFEST).unlink()
    return copy


def change_features(folder, change):
    """Changes the features of the first training clip and returns its name."""
    name = open_dataset(folder).names("train")[0]
    path = folder / "new_joint_vecs" / f"{name}.npy"
    np.save(path, change(np.load(path)))
    return name


def set_value(value, index):
    def change(features):
        features[index] = value
        return features

    return change


def test_a_good_folder_has_no_problems(synthetic_folder):
    report = audit_dataset(synthetic_folder)
    assert report.problems == []
    assert report.skeleton == "humanml3d"
    train = report.splits["train"]
    assert train.clips == 2 * train.mirrored == 32
    assert train.frames == sum(len(clip.features) for clip in open_dataset(synthetic_folder).clips("train"))
    assert train.captions == CAPTIONS * train.clips
    assert json.loads(json.dumps(dataclasses.asdict(report)))["splits"]["train"]["clips"] == 32


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (set_value(np.nan, (3, 5)), "1 values that are NaN"),
        (lambda features: features[:1], "has 1 frames"),
        (lambda features: features[:, :251], "expected T x 263"),
        (set_value(3.0, (4, 2)), "m/s"),
        (set_value(9.0, (slice(None), slice(3, 67))), "not on the floor"),
        (lambda features: features.astype(np.int64), "floating-point numbers"),
    ],
)
def test_broken_features_are_found(folder, change, words):
    name = change_features(folder, change)
    problems = audit_dataset(folder).problems
    assert any(name in problem and words in problem for problem in problems), problems


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "has no caption"),
        ("he waves##0.0#0.0\n", "no word/POS"),
        ("he waves#he wave#0.0#0.0\n", "a token that is not word/POS"),
        ("he # waves#he/PRON#0.0#0.0\n", "5 fields"),
        ("#he/PRON#0.0#0.0\n", "caption is empty"),
        ("he waves#he/PRON#1.0#99.0\n", "ends at 99.0 s"),
        ("he waves#he/PRON#2.0#1.0\n", "has times 2.0 to 1.0"),
    ],
)
def test_broken_captions_are_found(folder, text, words):
    name = open_dataset(folder).names("train")[0]
    (folder / "texts" / f"{name}.txt").write_text(text)
    problems = audit_dataset(folder).problems
    assert len(problems) == 1 and name in problems[0] and words in problems[0]


def test_a_long_caption_is_not_repeated_whole(folder):
    name = open_dataset(folder).names("train")[0]
    (folder / "texts" / f"{name}.txt").write_text(f"{'he waves ' * 100}##0.0#0.0\n")
    (problem,) = audit_dataset(folder).problems
    assert "caption 'he waves he waves" in problem and "...'" in problem and len(problem) < 200


def test_overlap_counts_twins(folder):
    name = open_dataset(folder).names("train")[0]
    with (folder / "test.txt").open("a") as file:
        file.write(f"M{name}\n")
    assert audit_dataset(folder).problems == [f"test.txt: {name} or its mirrored twin is in train.txt, too"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a\0b", "remove the control characters"),
        ("a\x1b[2Jb", "remove the control characters"),
        ("é" * 130, "more than 240 bytes"),
        ("../a", "remove the folder"),
    ],
)
@pytest.mark.parametrize("command", [["data", "check"], ["check"]])
def test_names_that_no_file_can_have_are_named_with_their_line(folder, capsys, command, name, words):
    with (folder / "val.txt").open("a") as file:
        file.write(f"{name}\n")
    assert main([*command, str(folder)]) == 1  # problems were found
    printed = capsys.readouterr()
    line = len((folder / "val.txt").read_text().splitlines())
    assert f"val.txt:{line}: " in printed.out and words in printed.out and "bug" not in printed.out + printed.err


def test_recordings_shared_with_training_are_noted(folder):
    dataset = open_dataset(folder)
    trained, held_out = (next(n for n in dataset.names(split) if n[0] != "M") for split in ("train", "test"))
    save_index(folder, [IndexEntry(trained, "one.bvh", ""), IndexEntry(held_out, "one.bvh", "")])
    clips = len(dataset.names("test"))
    said = f"2 of {clips} test clips are cut from recordings that are in train, too; protocol strict leaves them out"
    report = audit_dataset(folder)
    assert said in report.notes and not report.problems
    (folder / "index.csv").write_text("clip,source\na,b\n")
    assert audit_dataset(folder).problems == [
        f"{folder / 'index.csv'}: has no column new_name; its columns are clip, source"
    ]


def test_names_twice_orphans_and_missing_files(folder):
    train = open_dataset(folder).names("train")
    (folder / "train.txt").write_text("".join(f"{name}\n" for name in (*train[1:], train[1])))
    (folder / "new_joint_vecs" / f"{train[2]}.npy").unlink()
    problems = "\n".join(audit_dataset(folder).problems)
    assert f"names {train[1]} 2 times" in problems
    assert f"1 files of clips in no split list, such as {train[0]}.npy" in problems
    assert f"{train[2]}.npy: there is no such file" in problems


@pytest.mark.slow
def test_an_incomplete_humanml3d_is_one_line(shared_data):
    sample = shared_data("humanml3d-sample") / "humanml3d-sample" / "HumanML3D"
    report = audit_dataset(sample)
    (line,) = [problem for problem in report.problems if "missing" in problem]
    assert line.startswith("29,227 motions and 29,228 captions missing (such as ") and "github.com" in line
    assert len(line) < 200 and len(report.problems) < 5


def test_many_missing_files_of_own_data_are_counted(folder):
    names = open_dataset(folder).names("train")[:30]
    for name in names:
        (folder / "texts" / f"{name}.txt").unlink()
    assert f"30 captions missing (such as {names[0]}); import again" in audit_dataset(folder).problems


def test_foreign_statistics_are_found(folder):
    np.save(folder / "Mean.npy", np.load(folder / "Mean.npy") + 1)
    assert any("Mean.npy" in problem for problem in audit_dataset(folder).problems)
    (folder / "Mean.npy").unlink()
    assert any("Mean.npy" in problem for problem in audit_dataset(folder).problems)


def test_no_folder_is_a_user_error(tmp_path):
    with pytest.raises(UserError, match="no data set here"):
        audit_dataset(tmp_path)


def test_humanml3d_folders_are_copied_without_what_is_missing(folder, tmp_path):
    (folder / "dataset.yaml").unlink()
    shutil.rmtree(folder / "new_joints")
    name = open_dataset(folder).names("val")[0]
    (folder / "new_joint_vecs" / f"{name}.npy").unlink()
    (folder / "texts" / f"{name}.txt").unlink()
    report = import_humanml3d(folder, tmp_path / "copy")
    assert list(report.left_out) == [name]
    dataset = open_dataset(tmp_path / "copy")
    assert (dataset.folder / "dataset.yaml").exists() and name not in dataset.names("val")
    np.testing.assert_array_equal(dataset.normalizer.mean, open_dataset(folder).normalizer.mean)
    assert audit_dataset(tmp_path / "copy").problems == []


def test_an_import_says_that_lists_overlap(folder, tmp_path):
    name = open_dataset(folder).names("train")[0]
    with (folder / "test.txt").open("a") as file:
        file.write(f"{name}\n")
    report = import_humanml3d(folder, tmp_path / "copy")
    assert any(f"1 clips are in two lists, or twice in one, such as test.txt: {name}" in note for note in report.notes)


@pytest.mark.parametrize(
    "pattern", ["new_joint_vecs/*", "new_joints/*", "texts/*", "train.txt", "Mean.npy", "dataset.yaml", "index.csv"]
)
def test_a_changed_bit_is_named_after_an_import(synthetic_folder, tmp_path, pattern):
    folder = shutil.copytree(synthetic_folder, tmp_path / "data")
    path = sorted(folder.glob(pattern))[0]
    content = bytearray(path.read_bytes())
    content[8 if pattern == "dataset.yaml" else -2] ^= 1  # another letter or digit, which reads well
    path.write_bytes(content)
    assert main(["check", str(folder)]) == 1
    problems = [problem for problem in audit_dataset(folder).problems if MANIFEST in problem]
    assert problems == [
        f"{path}: has changed since it was written, or is damaged; if it was on purpose, delete {MANIFEST}; otherwise "
        "import again"
    ]


def test_many_changed_files_are_one_line_and_a_damaged_manifest_is_another(synthetic_folder, tmp_path):
    folder = shutil.copytree(synthetic_folder, tmp_path / "data")
    paths = sorted(folder.glob("texts/*"))
    for path in paths:
        path.write_text(path.read_text() + "a person#a/DET person/NOUN#0.0#0.0\n")
    (problem,) = audit_dataset(folder).problems
    assert problem.startswith(f"{len(paths)} files have changed since they were written, such as {paths[0]}: ")
    with (folder / MANIFEST).open("a") as file:
        file.write("\n")
    (problem,) = audit_dataset(folder).problems
    assert problem.startswith(f"{folder / MANIFEST}: damaged; ")


def test_every_folder_that_is_made_has_a_manifest(tmp_path):
    with new_folder(tmp_path / "data") as folder:
        (folder / "texts" / "a.txt").write_text("a")
    assert has_manifest(tmp_path / "data")


def run_cli(*arguments):
    """Runs `t2m data` with arguments."""
    import argparse

    parser = argparse.ArgumentParser()
    cli.add_arguments(parser)
    cli.run(parser.parse_args(arguments))


def test_check_prints_counts_and_writes_json(synthetic_folder, tmp_path, capsys):
    run_cli("check", str(synthetic_folder), "--json", str(tmp_path / "report.json"))
    printed = capsys.readouterr()
    assert "no problems found" in printed.out
    places = f"--data {synthetic_folder} --run runs/{synthetic_folder.name}-vqvae"
    assert printed.err.splitlines()[-1] == f"next: t2m train vqvae synthetic/vqvae --statistics data {places}"
    assert json.loads((tmp_path / "report.json").read_text())["problems"] == []


def test_check_ends_with_1_on_problems(folder, capsys):
    name = change_features(folder, set_value(np.nan, (0, 0)))
    with pytest.raises(SystemExit) as error:
        run_cli("check", str(folder))
    assert error.value.code == 1
    printed = capsys.readouterr()
    assert name in printed.out and "next:" not in printed.out + printed.err


@pytest.mark.slow
def test_synthetic_from_the_command_line(tmp_path, capsys):
    run_cli("synthetic", str(tmp_path / "my data"), "--num-clips", "20")
    printed = capsys.readouterr()
    assert "40 clips" in printed.out
    assert printed.err.splitlines()[-1] == f"next: t2m data check '{tmp_path / 'my data'}'"
    assert audit_dataset(tmp_path / "my data").problems == []


def test_seeds_that_synthetic_does_not_take_are_refused_in_one_line(tmp_path, capsys):
    assert main(["data", "synthetic", f"{tmp_path / 'data'}", "--num-clips", "20", "--seed", "-1"]) == 2
    assert capsys.readouterr().err == "t2m: error: seed: -1 is not between 0 and 4294967295\n"
    assert list(tmp_path.iterdir()) == []
