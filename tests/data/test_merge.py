import shutil

import numpy as np
import pytest

from t2m_jax.data.audit import audit_dataset
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.bvh import import_bvh_folder
from t2m_jax.data.importers.synthetic import write_synthetic_dataset
from t2m_jax.data.index import IndexEntry, load_index, save_index
from t2m_jax.data.merge import merge_datasets
from t2m_jax.errors import UserError
from tests.data.bvh_files import write_bvh


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A procedural data set and one imported from BVH, which has labels."""
    folder = tmp_path_factory.mktemp("merge")
    write_synthetic_dataset(folder / "made", num_clips=20, seed=0)
    for seed in range(8):
        write_bvh(folder / "source" / f"clip_{seed}.bvh", seed=seed)
    (folder / "info.yaml").write_text("name: source\nlicence: CC0\n")
    import_bvh_folder(folder / "source", folder / "own", caption_from_name=True, info=folder / "info.yaml")
    save_index(folder / "own", [IndexEntry(f"clip_{seed}", f"clip_{seed}.bvh", "turns left") for seed in range(8)])
    return folder / "made", folder / "own"


@pytest.mark.slow
def test_all_clips_of_all_splits_are_there(folders, tmp_path):
    report = merge_datasets(folders, tmp_path / "all")
    merged, parts = open_dataset(tmp_path / "all"), [open_dataset(folder) for folder in folders]
    for split in ("train", "val", "test"):
        assert merged.names(split) == tuple(name for part in parts for name in part.names(split))
    assert report.num_clips == sum(report.split_sizes.values()) == 2 * (20 + 8)
    names = [name for split in report.split_sizes for name in merged.names(split)]
    assert report.num_frames == sum(len(merged.features(name)) for name in names)
    for part in parts:
        name = part.names("train")[0]
        np.testing.assert_array_equal(merged.features(name), part.features(name))
        assert merged.captions(name) == part.captions(name)
    train = np.concatenate([clip.features for clip in merged.clips("train")])
    np.testing.assert_allclose(merged.normalizer.mean, train.mean(axis=0), atol=1e-4)
    assert audit_dataset(tmp_path / "all").problems == []


def test_labels_and_licenses_are_kept(folders, tmp_path):
    merge_datasets(folders, tmp_path / "all")
    index, info = load_index(tmp_path / "all"), open_dataset(tmp_path / "all").info
    assert index.label("Mclip_3") == "turns right" and index.source("clip_3") == "clip_3.bvh"
    made = open_dataset(folders[0]).info
    assert info.name == f"{made.name} and source" and info.licence == f"{made.licence}; CC0"


def test_positions_that_a_data_set_lacks_are_made(folders, tmp_path):
    merge_datasets(folders[1:], tmp_path / "copy")
    shutil.rmtree(tmp_path / "copy" / "new_joints")
    merge_datasets([tmp_path / "copy"], tmp_path / "again")
    for name in open_dataset(folders[1]).names("train"):
        whole, made = (np.load(folder / f"new_joints/{name}.npy") for folder in (folders[1], tmp_path / "again"))
        np.testing.assert_allclose(made, whole, atol=1e-6)


def test_refusals(folders, tmp_path):
    merge_datasets(folders[:1], tmp_path / "copy")
    with pytest.raises(UserError, match=r"is a clip of .*made, too"):
        merge_datasets([folders[0], tmp_path / "copy"], tmp_path / "all")
    with pytest.raises(UserError, match="no data set here"):
        merge_datasets([folders[0], tmp_path], tmp_path / "all")
    assert not (tmp_path / "all").exists()
