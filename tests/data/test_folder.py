import logging
import shutil

import numpy as np
import pytest

from t2m_jax.config import UserError
from t2m_jax.data.folder import Clip, DatasetInfo, open_dataset, samples_from_clip
from t2m_jax.data.texts import Caption


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
    assert not any(clip.is_mirrored for clip in clips)


def test_without_yaml_the_width_decides(folder):
    (folder / "dataset.yaml").unlink()
    info = open_dataset(folder).info
    assert (info.skeleton, info.fps, info.min_frames) == ("humanml3d", 20.0, 40)
    np.save(folder / "Mean.npy", np.zeros(251, np.float32))
    assert open_dataset(folder).info.skeleton == "kit_ml"
    np.save(folder / "Mean.npy", np.zeros(17, np.float32))
    with pytest.raises(UserError, match="17"):
        open_dataset(folder)


def test_wrong_width_names_the_file(folder):
    path = first_file(folder)
    np.save(path, np.zeros((50, 251), np.float32))
    with pytest.raises(UserError, match=rf"{path.name}.*50x251.*263"):
        open_dataset(folder).clips("train")


def test_missing_and_damaged_files_name_the_file(folder):
    path = first_file(folder)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(UserError, match=path.name):
        open_dataset(folder).clips("train")
    path.unlink()
    with pytest.raises(UserError, match=path.name):
        open_dataset(folder).clips("train")
    dataset = open_dataset(folder)
    assert len(dataset.clips("train", skip_missing=True)) == len(dataset.names("train")) - 1


def test_objects_in_npy_are_refused(folder):
    path = first_file(folder)
    np.save(path, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(UserError, match=path.name):
        open_dataset(folder).clips("train")


def test_nan_clips_are_left_out_and_counted(folder, caplog):
    path = first_file(folder)
    features = np.load(path)
    features[3, 7] = np.nan
    np.save(path, features)
    dataset = open_dataset(folder)
    with caplog.at_level(logging.WARNING, "t2m_jax.data.folder"):
        clips = dataset.clips("train")
    assert len(clips) == len(dataset.names("train")) - 1
    assert f"1 clips of train hold NaN and are left out: {path.stem}" in caplog.text


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


def test_time_tagged_captions_become_samples():
    info = DatasetInfo(name="x", min_frames=40, max_frames=196)
    whole, part, short = Caption("whole"), Caption("part", (), 1.0, 4.0), Caption("short", (), 1.0, 2.0)
    features = np.arange(100, dtype=np.float32)[:, None] * np.ones((1, 263), np.float32)
    samples = samples_from_clip(Clip("a", features, (whole, part, short)), info)
    assert [sample.name for sample in samples] == ["a", "A_a"]
    assert samples[0].captions == (whole,)
    np.testing.assert_array_equal(samples[1].features, features[20:80])
    assert samples[1].captions == (Caption("part"),)
    assert samples_from_clip(Clip("b", features[:39], (whole,)), info) == []
    assert samples_from_clip(Clip("c", features, (part,)), info)[0].name == "A_c"
