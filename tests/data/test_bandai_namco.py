import csv

import numpy as np
import pytest

from t2m_jax.data.audit import audit_dataset
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.bandai_namco import FLAGGED, import_bandai_namco, labels_from_name
from t2m_jax.errors import UserError
from tests.data.bvh_files import write_bvh

NAMES = (
    "dataset-1_bow_angry_001",
    "dataset-2_walk_active_001",
    "dataset-2_walk_active_002",
    "dataset-2_run_normal_001",
    "dataset-2_raise-up-left-hand_feminine_001",
    "dataset-2_walk-turn-left_masculine_006",
)


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """An archive of six short clips, the last of them flagged."""
    folder = tmp_path_factory.mktemp("archive")
    for seed, name in enumerate(NAMES):
        part = folder / "dataset" / f"Bandai-Namco-Research-Motiondataset-{name[8]}" / "data"
        write_bvh(part / f"{name}.bvh", seed=seed)
    return folder


@pytest.fixture(scope="module")
def lists(tmp_path_factory):
    """Split lists for the clips, the flagged one in train, one clip in none."""
    folder = tmp_path_factory.mktemp("lists")
    for split, names in {
        "train": (*NAMES[:2], NAMES[5], "dataset-2_walk_active_999"),
        "val": NAMES[2:3],
        "test": NAMES[3:4],
    }.items():
        (folder / f"{split}.txt").write_text("".join(f"{name}\n" for name in names))
    return folder


def test_import_with_lists(archive, lists, tmp_path):
    report = import_bandai_namco(archive, tmp_path / "data", splits=lists, workers=1)
    assert report.split_sizes == {"train": 4, "val": 2, "test": 2}
    assert set(report.left_out) == {NAMES[4], NAMES[5]}
    assert "flagged" in report.left_out[NAMES[5]] and "in no list" in report.left_out[NAMES[4]]
    dataset = open_dataset(tmp_path / "data")
    assert dataset.names("train") == (NAMES[0], "M" + NAMES[0], NAMES[1], "M" + NAMES[1])
    assert dataset.info.licence == "CC BY-NC 4.0" and "Bandai Namco Research" in dataset.info.attribution
    clips = dataset.clips("train")
    assert [len(clip.features) for clip in clips] == [29] * 4  # 45 frames at 30 a second are 30 at 20, one is lost
    mean = np.mean(np.concatenate([clip.features for clip in clips]), axis=0)
    np.testing.assert_allclose(dataset.normalizer.mean, mean, atol=1e-5)
    assert audit_dataset(tmp_path / "data").problems == []


def test_twins_are_mirror_images(archive, lists, tmp_path):
    import_bandai_namco(archive, tmp_path / "data", splits=lists, workers=1)
    original, twin = (np.load(tmp_path / f"data/new_joints/{mark}{NAMES[1]}.npy") for mark in ("", "M"))
    dataset = open_dataset(tmp_path / "data")
    left, right = (dataset.skeleton.joint_names.index(f"{side}_wrist") for side in ("left", "right"))
    # The template's limbs differ a little between left and right.
    np.testing.assert_allclose(twin[:, left] * [-1, 1, 1], original[:, right], atol=0.08)
    assert np.abs(twin[:, left] * [-1, 1, 1] - original[:, left]).max() > 0.01


def test_import_without_lists_is_repeatable(archive, tmp_path):
    first = import_bandai_namco(archive, tmp_path / "first", workers=1)
    import_bandai_namco(archive, tmp_path / "second", workers=1)
    assert "hash" in first.notes[0]
    for file in sorted(path for path in (tmp_path / "first").rglob("*") if path.is_file()):
        assert (tmp_path / "second" / file.relative_to(tmp_path / "first")).read_bytes() == file.read_bytes()


def test_flags_are_those_of_the_table_of_the_data(shared_dir):
    with (shared_dir / "data/bandai-namco-clips.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    assert frozenset(row["name"] for row in rows if row["flags"] not in ("", "moving joint_Root")) == FLAGGED


def test_broken_file_leaves_nothing_behind(archive, lists, tmp_path):
    source = tmp_path / "source"
    path = write_bvh(source / "dataset-2_walk_active_001.bvh")
    write_bvh(source / "dataset-2_walk_active_002.bvh")
    path.write_text(path.read_text()[:-200])
    with pytest.raises(UserError, match=r"dataset-2_walk_active_001\.bvh"):
        import_bandai_namco(source, tmp_path / "data", workers=1)
    assert [entry.name for entry in tmp_path.iterdir()] == ["source"]


def test_refusals(archive, lists, tmp_path):
    with pytest.raises(UserError, match="no dataset-N"):
        import_bandai_namco(tmp_path, tmp_path / "data")
    with pytest.raises(UserError, match=r"expected train\.txt"):
        import_bandai_namco(archive, tmp_path / "data", splits=tmp_path)
    with pytest.raises(UserError, match="exists already"):
        import_bandai_namco(archive, archive, splits=lists, workers=1)
    for split in ("train", "val", "test"):
        (tmp_path / f"{split}.txt").write_text(f"{NAMES[0]}\n")
    with pytest.raises(UserError, match="more than one"):
        import_bandai_namco(archive, tmp_path / "data", splits=tmp_path)


@pytest.mark.parametrize("name", ["walk", "dataset-1_fly_normal_001", "dataset-1_walk_bored_001"])
def test_unknown_names_and_labels(name):
    with pytest.raises(UserError, match=name):
        labels_from_name(name)
