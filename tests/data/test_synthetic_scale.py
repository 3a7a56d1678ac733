"""A data set like HumanML3D, made small: layout, clips, and the way from its folder to a trained VQ-VAE."""

import logging

import numpy as np
import pytest

from t2m_jax.data.audit import audit_dataset
from t2m_jax.data.banks.motions import compact, make_bank
from t2m_jax.data.cache import CACHE_FOLDER, CACHE_NAME
from t2m_jax.data.folder import open_dataset, samples_from_clip
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.data.splits import nested_choice
from t2m_jax.errors import UserError
from t2m_jax.models.vqvae import VqVaeConfig
from t2m_jax.motion.features import features_from_positions, positions_from_features
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.train.config import LoopConfig
from t2m_jax.train.experiment import train
from t2m_jax.train.vqvae_config import TrainVqVaeConfig
from tests.data.synthetic_scale import LONGEST, SHORTEST, stretched, write_scaled_dataset

BROKEN = ["000015", "M000015", "000010", "M000010"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scale") / "data"
    report = write_scaled_dataset(folder, num_clips=30, motions_a_kind=1)
    assert report.num_clips == 60 and report.split_sizes == {"train": 48, "val": 4, "test": 8}
    return folder


def lines(path):
    return path.read_text(encoding="utf-8").splitlines()


def test_layout_and_clips_are_those_of_humanml3d(folder):
    assert sorted(path.name for path in folder.iterdir() if path.name != CACHE_FOLDER) == sorted(
        [
            "Mean.npy",
            "Std.npy",
            "manifest.txt",
            "new_joint_vecs",
            "texts",
            *(f"{n}.txt" for n in ("all", "test", "train", "train_val", "val")),
        ]
    )
    assert lines(folder / "all.txt")[:4] == ["000000", "M000000", "000001", "M000001"]
    assert lines(folder / "train_val.txt") == lines(folder / "train.txt") + lines(folder / "val.txt")
    dataset = open_dataset(folder)
    assert (dataset.info.skeleton, dataset.info.min_frames, dataset.info.max_frames) == ("humanml3d", 40, 196)
    clips = {clip.name: clip for clip in dataset.clips("all")}
    assert sorted(set(lines(folder / "all.txt")) - clips.keys()) == sorted(BROKEN)
    lengths = [len(clip.features) for clip in clips.values()]
    assert min(lengths) >= SHORTEST and max(lengths) == LONGEST and 120 < np.mean(lengths) < 160
    for name, clip in clips.items():
        assert 3 <= len(clip.captions) <= 4
        assert len(clip.features) == len(clips[name.removeprefix("M")].features)
        assert samples_from_clip(clip, dataset.info)
    timed = [caption for clip in clips.values() for caption in clip.captions if not caption.whole_clip]
    assert timed and all(caption.start <= caption.end for caption in timed)


def test_nothing_but_the_broken_clips_is_wrong(folder):
    problems = audit_dataset(folder).problems
    assert sorted(problem.split("/")[1].split(".")[0] for problem in problems) == sorted(BROKEN)


def test_a_stretch_at_its_own_speed_is_a_cut():
    features = np.random.default_rng(0).normal(size=(50, 263)).astype(np.float32)
    features[:, HUMANML3D.layout.contacts] = np.round(np.abs(features[:, HUMANML3D.layout.contacts]))
    np.testing.assert_array_equal(stretched(features, start=7.0, speed=1.0, num_frames=20), features[7:27])


@pytest.mark.parametrize("speed", [0.75, 1.5])
def test_a_stretched_motion_goes_the_same_way_in_another_time(speed):
    positions = make_motion("walk-turn-left", seed=2, num_frames=200)
    features = features_from_positions(positions, HUMANML3D)
    steps = 90
    plain = positions_from_features(features, HUMANML3D)
    fast = positions_from_features(stretched(features, start=0.0, speed=speed, num_frames=steps + 1), HUMANML3D)
    np.testing.assert_allclose(fast[steps, 0], plain[int(steps * speed), 0], atol=0.08)
    assert np.linalg.norm(fast[steps, 0] - fast[0, 0]) > 1
    np.testing.assert_allclose(
        np.diff(fast, axis=0)[:, 0].mean(), speed * np.diff(plain, axis=0)[:135, 0].mean(), atol=0.01
    )


def test_the_seed_decides(folder, tmp_path):
    write_scaled_dataset(tmp_path / "again", num_clips=30, motions_a_kind=1)
    for file in sorted(path for path in (tmp_path / "again").rglob("*") if path.is_file()):
        assert (folder / file.relative_to(tmp_path / "again")).read_bytes() == file.read_bytes()


def test_too_few_clips_are_refused(tmp_path):
    with pytest.raises(UserError, match="is not a whole number from 20 to 100,000"):
        write_scaled_dataset(tmp_path / "few", num_clips=5)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.release
@pytest.mark.slow
def test_from_the_folder_to_a_trained_vqvae_without_a_copy_of_the_frames(folder, tmp_path, caplog):
    config = TrainVqVaeConfig(
        data=folder,
        run=tmp_path / "run",
        model=VqVaeConfig(width=8, code_dim=4, num_codes=8, depth=1, num_stages=1),
        window=16,
        loop=LoopConfig(num_steps=3, batch_size=4, validate_every=0, log_every=1, checkpoint_every=3),
        data_fraction=0.5,
    )
    with caplog.at_level(logging.WARNING):
        state = train(config)
    assert int(state.step) == 3
    dataset = open_dataset(folder)
    left_out = set(BROKEN) & set(nested_choice(dataset.names("train"), fraction=0.5, seed=0))
    assert left_out and all(name in caplog.text for name in left_out)
    assert (folder / CACHE_FOLDER / CACHE_NAME).exists()
    for fraction, is_shared in ((1.0, True), (0.5, False)):
        clips = dataset.clips("train", min_frames=16, fraction=fraction)
        frames, whole = compact(make_bank(clips, dataset.normalizer)).frames, clips[0].features.base
        assert np.shares_memory(frames, whole) == is_shared
        assert is_shared or len(frames) == sum(len(clip.features) for clip in clips), "more than the share is uploaded"
