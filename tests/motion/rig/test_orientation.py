"""Which axis is up, whether left is left, and where a rest pose ends: for made figures and for real recordings."""

import dataclasses

import numpy as np
import pytest

from t2m_jax.data.importers import motion_files
from t2m_jax.data.importers.bvh import import_bvh_folder
from t2m_jax.data.importers.motion_files import find_motion_files, open_motion_file
from t2m_jax.errors import UserError
from t2m_jax.motion.bvh import load_bvh, save_bvh
from t2m_jax.motion.mirroring import mirror_positions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig import retarget
from t2m_jax.motion.rig.orientation import find_up, left_is_left, rest_frames, to_y_up
from t2m_jax.motion.rig.retarget import clip_up, find_rig
from t2m_jax.motion.rotations import matrix_from_euler
from t2m_jax.motion.skeleton import HUMANML3D
from tests.data.bvh_files import write_bvh
from tests.motion.figures import walking_positions

# These two lie in the pose of a skeleton that has fallen apart.
BROKEN_LEGS = {"Rig_Medium|Skeletons_Death", "Rig_Medium|Skeletons_Death_Pose"}


@pytest.fixture
def clip(tmp_path):
    save_bvh(tmp_path / "walk.bvh", Motion(positions=walking_positions(40), fps=20.0))
    return load_bvh(tmp_path / "walk.bvh")


def turned(clip, axis, degrees, *, rest):
    """Returns a clip that is turned as a whole, with or without its rest pose."""
    order = {"x": "XYZ", "y": "YXZ", "z": "ZXY"}[axis]
    turn = matrix_from_euler(np.array([np.deg2rad(degrees), 0.0, 0.0]), order)
    rotations, translations = clip.rotations.copy(), clip.translations.copy()
    rotations[:, 0], translations[:, 0] = turn @ rotations[:, 0], translations[:, 0] @ turn.T
    offsets = clip.offsets @ turn.T if rest else clip.offsets
    if rest:  # as a program writes it whose axes are others: all offsets and rotations are in its frame
        rotations = turn @ clip.rotations @ turn.T
        translations = clip.translations @ turn.T
    return dataclasses.replace(clip, rotations=rotations, translations=translations.astype(np.float32), offsets=offsets)


def test_z_up_is_found_and_turned(clip):
    ahead = retarget(clip).positions
    z_up = turned(clip, "x", 90.0, rest=True)
    assert clip_up(clip, find_rig(clip, None)) == "y" and clip_up(z_up, find_rig(z_up, None)) == "z"
    np.testing.assert_allclose(retarget(z_up).positions, ahead, atol=1e-5)
    np.testing.assert_allclose(to_y_up(retarget(z_up, up="y").positions), ahead, atol=1e-5)


def test_somebody_who_lies_is_not_raised(clip):
    still = dataclasses.replace(clip, translations=np.broadcast_to(clip.translations[:1], clip.translations.shape))
    lying = turned(still, "x", 90.0, rest=False)
    assert clip_up(lying, find_rig(lying, None)) == "y"


def test_a_figure_that_lies_and_rises_may_stand(clip, tmp_path):
    """Motion with Z up on a rest pose with Y up, as some converters write it: the user has to say which it is."""
    risen = turned(clip, "x", 90.0, rest=False)
    with pytest.raises(UserError, match="may stand with Z up, or lie with Y up; say which with --up z or --up y"):
        retarget(risen)
    assert np.ptp(retarget(risen, up="z").positions[0, :, 1]) > 1 > np.ptp(retarget(risen, up="y").positions[0, :, 1])


def test_a_figure_without_bones_is_refused(clip):
    lengths = {"offsets": np.zeros_like(clip.offsets), "translations": np.zeros_like(clip.translations)}
    flat = dataclasses.replace(clip, **lengths, end_sites={})
    with pytest.raises(UserError, match="all joints are in one place"):
        retarget(flat)


def test_z_up_with_a_turned_root_is_y_up(clip):
    """As in some CMU files: the rest pose stands along Z, and a constant turn of the root raises it."""
    z_rest = turned(clip, "x", 90.0, rest=True)
    raised = turned(dataclasses.replace(z_rest, end_sites={}), "x", -90.0, rest=False)
    assert clip_up(raised, find_rig(raised, None)) == "y"


def test_what_cannot_be_told_is_refused():
    positions = walking_positions(20)
    along_z = positions[..., [0, 2, 1]] * np.array([1, -1, 1], np.float32)
    sideways = positions[0][:, [1, 0, 2]]
    assert find_up(along_z, sideways) is None
    still = along_z - along_z[:, :1] * np.array([0, 1, 0], np.float32)
    assert find_up(along_z, along_z[0]) == "z" and find_up(still, positions[0]) == "y"
    assert find_up(positions, sideways) == "y"
    # Somebody who bends in every frame, in a file with Z up.
    bent = matrix_from_euler(np.array([np.deg2rad(33), 0.0, 0.0]), "XYZ")
    assert find_up((along_z @ bent.T).astype(np.float32), along_z[0]) == "z"


def stepping_positions(num_frames=60):
    """A figure that goes by steps: in each half second, one foot rests and the other one overtakes it."""
    positions = np.repeat(walking_positions(1), num_frames, axis=0)
    time = np.arange(num_frames) / 20
    positions[..., 2] += time[:, None]
    for side, phase in (("left", 0.0), ("right", 0.5)):
        for name in ("ankle", "foot"):
            cycle, share = np.divmod(time + phase, 1.0)
            place = cycle + np.clip(2 * share - 1, 0, 1) - phase
            joint = HUMANML3D.joint_names.index(f"{side}_{name}")
            positions[:, joint, 2] = positions[0, joint, 2] + place
    return positions


def test_somebody_who_walks_along_z_stands_whatever_the_rest_pose_is():
    """As in files of 3ds Max and others, whose bones point along X without rotations."""
    walk = stepping_positions()
    along_z = walk[..., [0, 2, 1]] * np.array([1, -1, 1], np.float32)
    sideways = walk[0][:, [1, 0, 2]]
    assert find_up(along_z, sideways) == "z" and find_up(walk, sideways) == "y"
    # Somebody who is lifted while lying, who crawls along the body, or whose feet are no longer below the hips.
    lifted = np.repeat(along_z[:1], 60, axis=0) + np.linspace(0, 2, 60)[:, None, None] * np.array([0, 1, 0])
    crawls = along_z * np.array([1, 0.1, 1]) + np.linspace(0, 2, 60)[:, None, None] * np.array([0, 0, 1])
    for lying in (lifted, crawls, along_z[:15]):
        assert find_up(lying.astype(np.float32), sideways) is None
    assert find_up(along_z, walk[0]) is None, "a rest pose that stands along Y may be right"
    # Whichever way somebody walks, and if the first frame is the rest pose.
    along_x = walk[..., [2, 0, 1]]
    with_rest = np.concatenate([walk[:1], along_x])
    assert np.ptp(along_x[:, 0, 1]) < 0.5 and find_up(along_x, walk[0]) is find_up(with_rest, walk[0]) is None


def test_an_import_says_what_it_turned_and_takes_the_users_word(tmp_path):
    source = tmp_path / "source"
    path = write_bvh(source / "a.bvh")
    lines = path.read_text().split("\n")
    first = lines.index("Frame Time:\t0.0333333") + 1
    for number in range(first, len(lines) - 1):
        row = lines[number].split()
        row[4] = "90"  # the X rotation of the root: the figure lies on its back, or stands with Z up
        lines[number] = " ".join(row)
    path.write_text("\n".join(lines))
    report = import_bvh_folder(source, tmp_path / "y", caption_from_name=True, up="y")
    assert not any("Z was up" in note for note in report.notes)
    report = import_bvh_folder(source, tmp_path / "z", caption_from_name=True, up="z")
    heights = [np.ptp(np.load(tmp_path / up / "new_joints/a.npy")[0, :, 1]) for up in "yz"]
    assert heights[0] < 1 < heights[1]


def test_an_import_says_that_it_turned_a_figure(clip, tmp_path, monkeypatch):
    for up, degrees in (("y", 0.0), ("z", 90.0)):
        monkeypatch.setattr(motion_files, "load_bvh", lambda path, rig, by=degrees: turned(clip, "x", by, rest=True))
        report = import_bvh_folder(tmp_path, tmp_path / "data" / up, caption_from_name=True)
        assert any("Z was up; turned" in note for note in report.notes) == (up == "z")


def test_left_is_left_until_it_is_mirrored():
    positions = walking_positions(40)
    assert left_is_left(positions).all()
    assert not left_is_left(positions * np.array([-1, 1, 1], np.float32)).any()
    assert left_is_left(mirror_positions(positions, HUMANML3D)).all()
    assert left_is_left(positions[..., [2, 0, 1]]).all()  # wherever the figure lies


def test_an_import_with_exchanged_sides_is_refused(tmp_path):
    source, rig = tmp_path / "source", tmp_path / "rig.yaml"
    path = source / "a.bvh"
    source.mkdir()
    save_bvh(path, Motion(positions=walking_positions(40), fps=20.0))
    table = dict(find_rig(load_bvh(path), None).sources)
    swap = {"left": "right", "right": "left"}
    exchanged = {joint: table[joint.replace(side := joint.partition("_")[0], swap.get(side, side))] for joint in table}
    rig.write_text("".join(f"{joint}: {names[0]}\n" for joint, names in exchanged.items()))
    with pytest.raises(UserError, match="left and right are exchanged in 1 of 1 clips of rig"):
        import_bvh_folder(source, tmp_path / "data", caption_from_name=True, rig=str(rig))
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("held", [1, 5])
def test_a_t_pose_that_stands_in_place_is_cut(held):
    walk = walking_positions(40)
    joint = HUMANML3D.joint_names.index
    pose = walk[:1].copy()
    for side, sign in (("left", 1.0), ("right", -1.0)):
        shoulder = pose[:, joint(f"{side}_shoulder")]
        for reach, name in ((0.26, "elbow"), (0.52, "wrist")):
            pose[:, joint(f"{side}_{name}")] = shoulder + np.array([sign * reach, 0.0, 0.0], np.float32)
    assert rest_frames(np.concatenate([pose.repeat(held, 0), walk]), fps=20.0) == held
    assert rest_frames(walk, fps=20.0) == 0
    fading = np.linspace(pose[0], walk[0], 20)  # somebody who lowers the arms from a T-pose
    assert rest_frames(np.concatenate([fading, walk]).astype(np.float32), fps=20.0) == 0
    assert rest_frames(pose.repeat(40, 0), fps=20.0) == 0


@pytest.mark.slow
def test_rest_poses_of_real_recordings(shared_data):
    """The T-poses that the table of the CMU files lists."""
    folder = shared_data("cmu-bvh")
    found = {
        path.stem
        for path in find_motion_files(folder)
        if rest_frames(retarget(clip := load_bvh(path)).positions, fps=clip.fps)
    }
    assert found == {f"007_{trial:02}" for trial in (3, 4, 5, 6, 8, 9, 10, 12)}


@pytest.mark.slow
@pytest.mark.parametrize("archive", ["cmu-bvh", "cmu-dance", "cc0-glb", "cmu-asfamc-sample"])
def test_all_recordings_are_known_upright_and_not_exchanged(shared_data, archive):
    checked = 0
    for path in find_motion_files(shared_data(archive)):
        for motion, clip in open_motion_file(path).items():
            up = "y" if path.suffix == ".glb" else clip_up(clip, find_rig(clip, None))
            assert up == "y"
            share = left_is_left(retarget(clip, up="y").positions).mean()
            assert share > 0.5 or f"Rig_Medium|{motion.animation}" in BROKEN_LEGS, motion
            checked += 1
    assert checked > 5
