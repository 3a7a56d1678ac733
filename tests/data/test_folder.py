import logging
import re
import shutil

import numpy as np
import pytest

from t2m_jax.cli.main import main
from t2m_jax.data.files import FEATURES
from t2m_jax.data.folder import Clip, DatasetInfo, open_dataset, samples_from_clip
from t2m_jax.data.texts import Caption, parse_caption
from t2m_jax.errors import UserError


def text_of(path):
    return path.parents[1] / "texts" / f"{path.stem}.txt"


@pytest.fixture
def folder(synthetic_folder, tmp_path):
    """A copy that a test may break."""
    return shutil.copytree(synthetic_folder, tmp_path / "data")


def first_file(folder):
    return folder / "new_joint_vecs" / f"{open_dataset(folder).names('train')[0]}.npy"


def test_reads_what_was_written(synthetic_folder):
    dataset = open_dataset(synthetic_folder)
    clips = dataset.clips("train")
    assert [clip.name for clip in clips] == list(dataset.names("train"))
    assert all(clip.features.shape[1] == dataset.skeleton.feature_dim == 263 for clip in clips)
    assert all(clip.captions for clip in clips)
    assert dataset.info.name == "synthetic"
    assert dataset.info.fps == 20.0
    assert np.asarray(dataset.normalizer.mean).shape == (263,)


def test_twins_can_be_left_out(synthetic_folder):
    dataset = open_dataset(synthetic_folder)
    clips = dataset.clips("train", mirrored=False)
    assert 2 * len(clips) == len(dataset.names("train"))
    assert not any(clip.name.startswith("M") for clip in clips)


def test_without_yaml_the_width_decides(folder):
    (folder / "dataset.yaml").unlink()
    info = open_dataset(folder).info
    assert (info.skeleton, info.fps, info.min_frames) == ("humanml3d", 20.0, 40)
    np.save(folder / "Mean.npy", np.zeros(251, np.float32))
    assert open_dataset(folder).info.skeleton == "kit_ml"
    np.save(folder / "Mean.npy", np.zeros(17, np.float32))
    with pytest.raises(UserError, match="17"):
        open_dataset(folder)


def damaged(path):
    path.write_bytes(path.read_bytes()[:100])


def with_nan(path):
    features = np.load(path)
    features[3, 7] = np.nan
    np.save(path, features)


def replaced_by_link_to_itself(path):
    path.unlink()
    path.symlink_to(path)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (damaged, "with a damaged motion file"),
        (with_nan, "with NaN or infinite values"),
        (lambda path: path.unlink(), "without motion file"),
        (lambda path: np.save(path, np.zeros((50, 251), np.float32)), "with 251 features in place of 263"),
        (lambda path: np.save(path, np.zeros(263, np.float32)), "with an array of 1 axes in place of 2"),
        (lambda path: np.save(path, np.zeros((1, 263), np.float32)), "of 1 frame"),
        (lambda path: np.save(path, np.zeros((0, 263), np.float32)), "of 0 frames"),
        (lambda path: np.save(path, np.full((50, 263), 1e300)), "with NaN or infinite values"),
        (lambda path: np.save(path, np.zeros((50, 263), np.int64)), "with a damaged motion file"),
        (lambda path: np.save(path, np.array([{"a": 1}], object), allow_pickle=True), "with a damaged motion file"),
        (replaced_by_link_to_itself, "without motion file"),
        (lambda path: text_of(path).unlink(), "without caption file"),
        (lambda path: text_of(path).write_bytes(b"\xff"), "with a damaged caption file"),
        (lambda path: [path.unlink(), text_of(path).unlink()], "without motion and caption file"),
    ],
)
def test_clips_that_cannot_be_used_are_left_out_and_named(folder, caplog, spoil, reason):
    path = first_file(folder)
    spoil(path)
    dataset = open_dataset(folder)
    with caplog.at_level(logging.WARNING, "t2m_jax.data.folder"):
        clips = dataset.clips("train")
    assert [clip.name for clip in clips] == list(dataset.names("train")[1:])
    assert f"1 of 32 clips cannot be used: 1 {reason} ({path.stem}); left out of train" in caplog.text


def test_many_left_out_clips_are_counted_by_kind(folder, caplog):
    names = open_dataset(folder).names("train")
    for name in names[:7]:
        with_nan(folder / FEATURES / f"{name}.npy")
    (folder / FEATURES / f"{names[9]}.npy").unlink()
    with caplog.at_level(logging.WARNING, "t2m_jax.data.folder"):
        assert len(open_dataset(folder).clips("train")) == 24
    kinds = f"7 with NaN or infinite values ({', '.join(names[:5])}, ...); 1 without motion file ({names[9]})"
    assert f"8 of 32 clips cannot be used: {kinds}" in caplog.text


def test_a_split_that_mostly_cannot_be_used_is_refused(folder):
    names = open_dataset(folder).names("train")
    for name in names[:16]:
        text_of(folder / FEATURES / f"{name}.npy").unlink()
    assert len(open_dataset(folder).clips("train")) == 16
    with_nan(folder / FEATURES / f"{names[20]}.npy")
    with pytest.raises(UserError, match=r"train\.txt: 17 of 32 clips cannot be used: 16 without caption file \(.*copy"):
        open_dataset(folder).clips("train")


def test_a_broken_caption_line_costs_one_caption(folder, caplog):
    text = text_of(first_file(folder))
    lines = text.read_text().splitlines()
    text.write_text("\n".join([*lines[:2], "he # waves#he/PRON#0.0#0.0", "he waves#he/PRON#0.0#inf", *lines[2:]]))
    with caplog.at_level(logging.WARNING, "t2m_jax.data.folder"):
        clips = open_dataset(folder).clips("train")
    assert len(clips) == 32 and len(clips[0].captions) == len(lines)
    assert f"2 caption lines of train cannot be read and are left out, in clips {text.stem}" in caplog.text


def test_shares_of_a_split_are_nested(synthetic_folder):
    dataset = open_dataset(synthetic_folder)
    names = {share: [clip.name for clip in dataset.clips("train", fraction=share)] for share in (0.25, 0.5, 1.0)}
    assert [len(chosen) for chosen in names.values()] == [8, 16, 32]
    assert set(names[0.25]) < set(names[0.5]) < set(names[1.0])
    assert names[0.5] != [clip.name for clip in dataset.clips("train", fraction=0.5, seed=1)]
    assert names[0.5] == [name for name in dataset.names("train") if name in names[0.5]]


def test_short_clips_are_left_out(synthetic_folder, caplog):
    dataset = open_dataset(synthetic_folder)
    clips = dataset.clips("train", min_frames=80)
    assert 0 < len(clips) < len(dataset.names("train"))
    assert all(len(clip.features) >= 80 for clip in clips)
    assert "shorter than 80" in caplog.text


def test_no_folder_no_list_and_strange_names_are_user_errors(folder, tmp_path):
    with pytest.raises(UserError, match="no data set here"):
        open_dataset(tmp_path / "nowhere")
    with pytest.raises(UserError, match=r"dev\.txt"):
        open_dataset(folder).clips("dev")
    (folder / "dev.txt").write_text("../../etc/passwd\n")
    with pytest.raises(UserError, match=r"dev\.txt:1"):
        open_dataset(folder).clips("dev")


def test_the_mark_that_some_editors_write_first_is_no_part_of_a_name_or_a_caption(folder):
    (*_, name) = names = open_dataset(folder).names("train")
    caption = open_dataset(folder).captions(name)[0]
    for path in (folder / "train.txt", folder / "texts" / f"{name}.txt"):
        path.write_text(path.read_text(), encoding="utf-8-sig")
    assert open_dataset(folder).names("train") == names and open_dataset(folder).captions(name)[0] == caption


@pytest.mark.parametrize(("fps", "shown"), [("-5", "-5.0"), ("0.0", "0.0"), (".inf", "inf"), ("1000.5", "1000.5")])
def test_impossible_rates_are_refused_in_one_line(folder, capsys, fps, shown):
    info = folder / "dataset.yaml"
    text, count = re.subn(r"(?m)^fps: .*$", f"fps: {fps}", info.read_text())
    info.write_text(text)
    assert count == 1
    with pytest.raises(UserError, match=rf"dataset\.yaml: fps: {shown} is not a number of frames per second"):
        open_dataset(folder)
    assert main(["data", "check", f"{folder}"]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.startswith(f"t2m: error: {info}: fps: {shown} is not a number")
    assert printed.err.count("\n") == 1


def numbered(num_frames):
    """Features whose every value is the number of the frame."""
    return np.arange(num_frames, dtype=np.float32)[:, None] * np.ones((1, 263), np.float32)


def test_time_tagged_captions_become_samples():
    info = DatasetInfo(name="x", min_frames=40, max_frames=196)
    whole, part, short = Caption("whole"), Caption("part", (), 1.0, 4.0), Caption("short", (), 1.0, 2.0)
    features = numbered(100)
    samples = samples_from_clip(Clip("a", features, (whole, part, short)), info)
    assert [sample.name for sample in samples] == ["a", "A_a"]
    assert samples[0].captions == (whole,)
    np.testing.assert_array_equal(samples[1].features, features[20:80])
    assert samples[1].captions == (Caption("part"),)
    assert samples_from_clip(Clip("b", features[:39], (whole,)), info) == []
    assert samples_from_clip(Clip("c", features, (part,)), info)[0].name == "A_c"


def published_samples(num_frames, tags, *, fps, shortest):
    """First and last frame of each sample as the published loaders find them; (0, rows) for the whole clip."""
    if not shortest <= num_frames < 200:
        return []
    rows, samples, has_whole = list(range(num_frames)), [], False
    for start, end in tags:
        start, end = (0.0 if time != time else time for time in (start, end))
        if start == 0.0 and end == 0.0:
            has_whole = True
            continue
        part = rows[int(start * fps) : int(end * fps)]
        if shortest <= len(part) < 200:
            samples.append((part[0], part[-1]))
    return [(0, num_frames - 1)] * has_whole + samples


NAN = float("nan")
KIT_ML = DatasetInfo(name="kit", skeleton="kit_ml", fps=12.5, min_frames=24, max_frames=196)
HUMANML3D = DatasetInfo(name="humanml3d", min_frames=40, max_frames=196)


@pytest.mark.parametrize("info", [HUMANML3D, KIT_ML], ids=["humanml3d", "kit_ml"])
@pytest.mark.parametrize("num_frames", [23, 24, 39, 40, 150, 199, 200])
@pytest.mark.parametrize(
    "tags",
    [
        [(0.0, 0.0)],
        [],
        [(NAN, NAN), (0.0, 3.7)],
        [(1.0, NAN), (NAN, 4.0)],
        [(1.03, 6.66), (0.0, 99.0), (20.0, 30.0)],
        [(4.0, 4.0), (6.0, 2.0)],
        [(0.1 * number, 8.0) for number in range(30)],
    ],
    ids=["whole", "none", "nan", "half nan", "beyond the end", "backwards", "thirty"],
)
def test_samples_are_those_of_the_published_loaders(info, num_frames, tags):
    captions = tuple(
        parse_caption(f"text {number}#a/DET#{start}#{end}", source="x:1") for number, (start, end) in enumerate(tags)
    )
    samples = samples_from_clip(Clip("a", numbered(num_frames), captions), info)
    spans = [(int(sample.features[0, 0]), int(sample.features[-1, 0])) for sample in samples]
    assert spans == published_samples(num_frames, tags, fps=info.fps, shortest=info.min_frames)
    assert len({sample.name for sample in samples}) == len(samples)
    assert all(len(sample.captions) == 1 for sample in samples if sample.name != "a")


def test_more_parts_than_letters_have_two():
    captions = tuple(Caption(f"{number}", (), 0.05 * number, 8.0) for number in range(1, 31))
    names = [sample.name for sample in samples_from_clip(Clip("a", numbered(170), captions), HUMANML3D)]
    assert (names[0], names[25], names[26], names[29]) == ("A_a", "Z_a", "AA_a", "AD_a")


def test_statistics_of_another_skeleton_are_refused(folder):
    for name in ("Mean", "Std"):
        np.save(folder / f"{name}.npy", np.ones(251, np.float32))
    with pytest.raises(UserError, match=r"Mean\.npy: has 251 columns, but skeleton humanml3d has 263"):
        _ = open_dataset(folder).normalizer
    (folder / "dataset.yaml").unlink()
    np.save(folder / "Mean.npy", np.float32(1))
    with pytest.raises(UserError):
        open_dataset(folder)
