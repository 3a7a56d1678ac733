"""Acclaim files against the same recordings as BVH, and damaged ones."""

import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.motion.amc import find_skeleton, load_amc
from t2m_jax.motion.formats import load_motion
from t2m_jax.motion.rig import retarget
from t2m_jax.motion.rig.orientation import left_is_left

from .acclaim_files import AMC, ASF, write_acclaim

UNIT = 0.0254 / 0.45
KNEES = ["left_knee", "right_knee", "left_ankle", "right_ankle", "left_elbow", "right_elbow", "left_wrist"]


def test_lengths_places_and_angles(tmp_path):
    clip = load_amc(write_acclaim(tmp_path))
    assert clip.joint_names == ("root", "thigh", "shin") and clip.parents == (-1, 0, 1) and clip.fps == 120.0
    positions = clip.with_end_sites().positions
    np.testing.assert_allclose(positions[0, 0], [0, 18 * UNIT, 9 * UNIT], atol=1e-6)
    # A turn of 30 degrees about the bone's own x axis, which its frame turns to y: the bone along y stays in place.
    np.testing.assert_allclose(positions[0, 2] - positions[0, 0], [0, -7 * UNIT, 0], atol=1e-6)
    np.testing.assert_allclose(positions[1, 3] - positions[1, 2], [0, -8 * UNIT, 0], atol=1e-6)


def test_the_first_angle_turns_first(tmp_path):
    asf = ASF.replace("axis 0 0 90 XYZ", "axis 0 0 0 XYZ").replace("dof rx ry", "dof rx rz")
    clip = load_amc(write_acclaim(tmp_path, asf=asf, amc=AMC.replace("thigh 30 0", "thigh 90 90")))
    # About x, down (-y) goes to -z, which a turn about z leaves where it is.
    np.testing.assert_allclose(clip.positions[0, 2] - clip.positions[0, 1], [0, 0, -7 * UNIT], atol=1e-6)


def test_real_recordings_stand_on_the_floor_and_left_is_left(shared_data):
    files = sorted(shared_data("cmu-asfamc-sample").rglob("*.amc"))
    assert len(files) == 6
    for path in files:
        motion = load_motion(path)
        assert left_is_left(motion.positions).mean() > 0.95
        assert 0.8 < np.ptp(motion.positions[0, :, 1]) < 1.9


def test_a_skeleton_in_another_unit_has_the_size_of_a_person(shared_data, tmp_path):
    path = sorted(shared_data("cmu-asfamc-sample").rglob("*.amc"))[0]
    (tmp_path / "a.amc").write_bytes(path.read_bytes())
    expected = load_amc(path)
    for length in ("0.001", "10"):  # a giant of 750 m, and a doll of 8 cm
        (tmp_path / "a.asf").write_text(find_skeleton(path).read_text().replace("length 0.45", f"length {length}"))
        clip = load_amc(tmp_path / "a.amc")
        np.testing.assert_allclose(clip.translations, expected.translations, rtol=1e-4, atol=1e-5)
        assert clip.notes == (*expected.notes, "lengths are taken as units of CMU's skeletons (5.64 cm)")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("thigh 30 0", "thigh 30"), r"02_01\.amc:6: thigh has 1 values, its skeleton says 2"),
        (("thigh 30 0", "thigh 30 x"), r"02_01\.amc:6: '30 x' are not numbers"),
        (("thigh 30 0", "thigh 30 1e400"), r"02_01\.amc:6: '30 1e400' are not numbers"),
        (("thigh 30 0", "knee 30 0"), r"02_01\.amc:6: expected .* not 'knee'"),
        (("\nthigh 0 0", ""), r"02_01\.amc: frame 2 has other bones"),
        (("\n2\n", "\n4\n"), r"02_01\.amc:\d+: frame 4 comes after frame 1; frames are missing"),
        (("\n2\n", "\n1\n"), r"02_01\.amc:\d+: frame 1 comes after frame 1; frames are missing or doubled"),
        ((AMC, "# nothing\n"), r"02_01\.amc: has no frames"),
        (("length 0.45", "length 0"), r"02\.asf:4: length is 0"),
        (("length 0.45", "length 1e-300"), r"02\.asf:4: length is 1e-300; expected 0\.0001 to 10000"),
        (("length 7.0", "length"), r"02\.asf:\d+: length needs 1 numbers, has 0"),
        (("direction 0 -1 0\n     length 7", "length 7"), r"02\.asf:\d+: direction needs 3 numbers"),
        (("dof rx ry", "dof rx rx"), r"02\.asf:\d+: 'dof rx rx': expected"),
        (("axis 0 0 90 XYZ", "axis 0 0 90 XXZ"), r"02\.asf:\d+: the order of the axes is 'XXZ'"),
        (("name shin", "name thigh"), r"02\.asf:\d+: bone 'thigh'"),
        (("thigh shin", "shin thigh"), r"02\.asf:\d+: shin thigh"),
        ((":hierarchy", ":tree"), r"02\.asf: is not an ASF file; it has no :hierarchy"),
    ],
)
def test_damage_is_named(tmp_path, change, says):
    path = write_acclaim(tmp_path, asf=ASF.replace(*change), amc=AMC.replace(*change))
    with pytest.raises(UserError, match=says):
        load_amc(path)


@pytest.mark.parametrize("fps", [0.0, -120.0, float("nan"), float("inf"), 1e9])
def test_rates_that_cannot_be_are_refused(tmp_path, fps):
    with pytest.raises(UserError, match=r"02_01\.amc: .* is not a number of frames per second"):
        load_amc(write_acclaim(tmp_path), fps=fps)


def test_the_skeleton_is_found_by_its_name(tmp_path):
    path = write_acclaim(tmp_path)
    (tmp_path / "03.asf").write_text("another")
    assert load_amc(path).num_frames == 2
    (tmp_path / "02.asf").rename(tmp_path / "04.asf")
    with pytest.raises(UserError, match=r"02_01\.amc: no one of 2 \.asf files has its name"):
        load_amc(path)
    (tmp_path / "03.asf").unlink()
    assert load_amc(path).num_frames == 2
    (tmp_path / "04.asf").unlink()
    with pytest.raises(UserError, match=r"there is no \.asf file next to it"):
        load_amc(path)


def test_a_longer_number_is_another_name(tmp_path):
    path = write_acclaim(tmp_path).rename(tmp_path / "100_01.amc")
    (tmp_path / "02.asf").rename(tmp_path / "100.asf")
    (tmp_path / "10.asf").write_text("another")
    assert load_amc(path).num_frames == 2
    (tmp_path / "100.asf").rename(tmp_path / "20.asf")
    with pytest.raises(UserError, match=r"100_01\.amc: no one of 2 \.asf files has its name"):
        load_amc(path)


@pytest.mark.parametrize(
    ("motion", "skeletons", "found"),
    [
        ("charleston1", ("backflip", "charleston"), "charleston"),
        ("walk1", ("walk", "walk1", "walk10"), "walk1"),
        ("02_01", ("02", "02_01", "2"), "02_01"),
        ("02_walk", ("02", "03"), "02"),
        ("Walk-1", ("walk", "wal"), "walk"),
        ("walking", ("walk", "run"), None),
        ("100_01", ("10", "1"), None),
    ],
)
def test_of_several_skeletons_the_longest_whole_name_is_used(tmp_path, motion, skeletons, found):
    for name in skeletons:
        (tmp_path / f"{name}.asf").touch()
    if found is None:
        with pytest.raises(UserError, match=r"no one of 2 \.asf files has its name"):
            find_skeleton(tmp_path / f"{motion}.amc")
    else:
        assert find_skeleton(tmp_path / f"{motion}.amc") == tmp_path / f"{found}.asf"


def test_a_motion_may_have_another_unit_of_angles_than_its_skeleton(tmp_path):
    degrees = load_amc(write_acclaim(tmp_path))
    amc = ":RADIANS\n" + AMC.replace(":DEGREES\n", "").replace("thigh 30 0", f"thigh {np.deg2rad(30)} 0")
    radians = load_amc(write_acclaim(tmp_path, amc=amc))
    np.testing.assert_allclose(radians.rotations[0, 1], degrees.rotations[0, 1], atol=1e-6)


def test_limbs_point_as_in_the_same_recording_as_bvh(shared_data):
    """The BVH files were made from these, on another figure; limbs have the same directions within two degrees."""
    from t2m_jax.motion.bvh import load_bvh
    from t2m_jax.motion.skeleton import HUMANML3D

    amc = shared_data("cmu-asfamc-sample") / "cmu-asfamc/03/03_02.amc"
    (bvh,) = shared_data("cmu-bvh").rglob("003_02.bvh")
    ours, theirs = load_motion(amc).positions[::2], retarget(load_bvh(bvh)).positions
    count = min(len(ours), len(theirs))
    for name in KNEES:
        joint = HUMANML3D.joint_names.index(name)
        bones = [found[:count, joint] - found[:count, HUMANML3D.parents[joint]] for found in (ours, theirs)]
        first, second = (bone / np.linalg.norm(bone, axis=-1, keepdims=True) for bone in bones)
        assert np.rad2deg(np.arccos(np.clip((first * second).sum(-1), -1, 1))).mean() < 3, name
