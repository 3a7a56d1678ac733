import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.motion.features import features_from_positions
from t2m_jax.motion.formats import load_motion, motion_formats
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML
from tests.motion.glb_files import write_person
from tests.motion.rig.test_retarget import BANDAI


def test_every_format_is_registered():
    assert set(motion_formats()) >= {"npz", "bvh", "gif", "mp4", "html"}


@pytest.mark.parametrize("suffix", [".npz", ".bvh"])
def test_saved_motions_are_read(tmp_path, walk, suffix):
    walk.save(tmp_path / f"walk{suffix}")
    back = load_motion(tmp_path / f"walk{suffix}")
    assert back.fps == pytest.approx(20.0) and back.positions.shape == walk.positions.shape
    assert np.linalg.norm(back.positions - walk.positions, axis=-1).mean() < 0.01


def test_arrays_of_data_sets_are_read_by_their_width(tmp_path, walk, kit_walk):
    path = tmp_path / "array.npy"
    np.save(path, walk.positions)
    np.testing.assert_array_equal(load_motion(path).positions, walk.positions)
    features = features_from_positions(walk.positions, HUMANML3D)
    np.save(path, features)
    back = load_motion(path)
    np.testing.assert_array_equal(back.features, features)
    np.testing.assert_allclose(back.positions, walk.positions[:-1], atol=1e-4)
    np.save(path, kit_walk.positions / KIT_ML.metres_per_unit)
    back = load_motion(path)
    assert back.skeleton is KIT_ML and back.fps == 12.5
    np.testing.assert_allclose(back.positions, kit_walk.positions, atol=1e-6)
    np.save(path, features_from_positions(kit_walk.positions / KIT_ML.metres_per_unit, KIT_ML))
    assert load_motion(path).skeleton is KIT_ML


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((10, 262), np.float32), r"\[10, 262\]"),
        (np.zeros((10, 23, 3), np.float32), r"\[10, 23, 3\]"),
        (np.zeros((10, 263), np.int32), "floating-point numbers"),
        (np.full((10, 263), np.nan, np.float32), "not finite"),
        (np.zeros((0, 263), np.float32), "frame"),
        (np.array([{}], dtype=object), "not a complete .npy file"),
    ],
)
def test_other_arrays_are_refused(tmp_path, array, message):
    path = tmp_path / "array.npy"
    np.save(path, array, allow_pickle=True)
    with pytest.raises(UserError, match=message) as caught:
        load_motion(path)
    assert "array.npy" in str(caught.value)


def test_unknown_and_absent_files_are_refused(tmp_path):
    with pytest.raises(UserError, match=r"use one of \.amc, \.bvh, \.glb, \.npy, \.npz"):
        load_motion(tmp_path / "a.fbx")
    for suffix in (".npz", ".bvh", ".glb", ".amc", ".npy"):
        with pytest.raises(UserError, match="no such file"):
            load_motion(tmp_path / f"a{suffix}")
    (tmp_path / "a.bvh").mkdir()
    with pytest.raises(UserError, match=r"a\.bvh: is a folder"):
        load_motion(tmp_path / "a.bvh")


def test_bvh_holds_one_motion(tmp_path, walk):
    from t2m_jax.export.formats import save_bvh_file

    with pytest.raises(UserError, match="exactly one"):
        save_bvh_file(tmp_path / "a.bvh", [walk, walk])


@pytest.mark.parametrize("suffix", [".npz", ".bvh", ".gif", ".mp4", ".html"])
def test_a_failure_leaves_nothing_behind(tmp_path, walk, suffix):
    if suffix == ".mp4":
        pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")
    short = Motion(walk.positions[:2], 20.0)
    folder = tmp_path / f"folder{suffix}"
    folder.mkdir()
    with pytest.raises(UserError):
        short.save(folder)
    with pytest.raises(UserError):
        short.save(tmp_path / "absent" / f"a{suffix}")
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(UserError):
        short.save(tmp_path / "file" / f"a{suffix}")
    with pytest.raises(UserError):
        short.save(tmp_path / ("very long name" * 30 + suffix))
    assert {path.name for path in tmp_path.iterdir()} == {folder.name, "file"}


def test_an_animation_of_a_glb_file_is_chosen_by_name(tmp_path):
    path = write_person(tmp_path / "one.glb", BANDAI, {"Armature|Turn": 90.0})
    assert load_motion(path).num_frames == 21 and load_motion(path, animation="Turn").skeleton is HUMANML3D
    path = write_person(tmp_path / "two.glb", BANDAI, {"Armature|Turn": 90.0, "Armature|Stand": 0.0})
    with pytest.raises(UserError, match=r"two\.glb: has several animations; .*Armature\|Turn, Armature\|Stand"):
        load_motion(path)
    with pytest.raises(UserError, match=r"two\.glb: has no animation 'Jump'"):
        load_motion(path, animation="Jump")
    turned, still = (load_motion(path, animation=name).positions for name in ("Turn", "Armature|Stand"))
    np.testing.assert_allclose(turned[0], still[0], atol=1e-6)
    assert np.abs(still[-1] - still[0]).max() < 1e-6 < 0.3 < np.abs(turned[-1] - turned[0]).max()
