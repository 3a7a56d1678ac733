"""`.npz` files in the layout of AMASS: what programs with the body model SMPL make of them, and reading them back."""

import logging

import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.data.importers.motion_files import find_motion_files
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.motion.smpl import OFFSETS, clip_from_smpl, up_of_smpl

NAMES = HUMANML3D.joint_names
# The skeleton of SMPL's mean body, as simulations of physics have it, with its slightly different sides.
SIMULATED = np.array(
    [
        (-0.0018, -0.2233, 0.0282), (0.0695, -0.0914, -0.0068), (-0.0677, -0.0905, -0.0043), (-0.0025, 0.1090, -0.0267),
        (0.0343, -0.3752, -0.0045), (-0.0383, -0.3826, -0.0089), (0.0055, 0.1352, 0.0011), (-0.0136, -0.3980, -0.0437),
        (0.0158, -0.3984, -0.0423), (0.0015, 0.0529, 0.0254), (0.0264, -0.0558, 0.1193), (-0.0254, -0.0481, 0.1233),
        (-0.0028, 0.2139, -0.0429), (0.0788, 0.1217, -0.0341), (-0.0818, 0.1188, -0.0386), (0.0052, 0.0650, 0.0513),
        (0.0910, 0.0305, -0.0089), (-0.0961, 0.0325, -0.0091), (0.2596, -0.0128, -0.0275), (-0.2537, -0.0133, -0.0214),
        (0.2492, 0.0090, -0.0012), (-0.2553, 0.0078, -0.0056),
    ]
)  # fmt: skip


def rotated(vector, axis_angle):
    """Rodrigues' formula."""
    angle = np.linalg.norm(axis_angle)
    axis = axis_angle / max(angle, 1e-12)
    turned = vector * np.cos(angle) + np.cross(axis, vector) * np.sin(angle)
    return turned + axis * (axis @ vector) * (1 - np.cos(angle))


def posed(poses, trans):
    """Returns the 22 joints of one frame as SMPL poses its skeleton, Z up."""
    places = [SIMULATED[0] + trans]
    for joint in range(1, 22):
        parent = HUMANML3D.parents[joint]
        offset, above = SIMULATED[joint], parent
        while above >= 0:
            offset, above = rotated(offset, poses[3 * above : 3 * above + 3]), HUMANML3D.parents[above]
        places.append(places[parent] + offset)
    return np.array(places)


def directions(positions, *pairs):
    bones = [positions[:, NAMES.index(b)] - positions[:, NAMES.index(a)] for a, b in pairs]
    return np.stack([bone / np.linalg.norm(bone, axis=-1, keepdims=True) for bone in bones], axis=1)


def apart(first, second, *pairs):
    """Returns the largest angle between the same bones of two motions, in degrees."""
    cosines = np.sum(directions(first, *pairs) * directions(second, *pairs), axis=-1)
    return np.rad2deg(np.arccos(np.clip(cosines, -1, 1))).max()


@pytest.fixture(scope="module")
def motion():
    return Motion(make_motion("walk", seed=4, num_frames=30), 20.0, caption="a person walks").turned(100)


@pytest.fixture
def file(motion, tmp_path):
    motion.save(tmp_path / "a.npz", names="smpl")
    return dict(np.load(tmp_path / "a.npz"))


def test_the_layout_is_that_of_amass(file):
    shapes = {name: value.shape for name, value in file.items()}
    assert shapes == {
        "poses": (30, 156), "trans": (30, 3), "betas": (16,), "dmpls": (30, 8), "gender": (), "mocap_framerate": (),
        "mocap_frame_rate": (),
    }  # fmt: skip
    assert file["mocap_framerate"] == file["mocap_frame_rate"] == 20 and file["gender"] == "neutral"
    assert not (file["betas"].any() or file["dmpls"].any() or file["poses"][:, 66:].any())


def test_smpls_joints_are_where_the_motion_has_them_in_direction(file, motion):
    joints = np.array([posed(*frame) for frame in zip(file["poses"], file["trans"], strict=True)])
    joints = joints[..., [0, 2, 1]] * (1, 1, -1)  # Y up
    for side in ("left", "right"):
        arm = [(f"{side}_shoulder", f"{side}_elbow"), (f"{side}_elbow", f"{side}_wrist")]
        leg = [(f"{side}_hip", f"{side}_knee"), (f"{side}_knee", f"{side}_ankle")]
        assert apart(joints, motion.positions, *arm) < 4
        assert apart(joints, motion.positions, *leg) < 10
    assert apart(joints, motion.positions, ("right_hip", "left_hip"), ("right_shoulder", "left_shoulder")) < 6
    # It stands on the floor, and walks as far as its legs do.
    lowest = joints[..., 1].min(axis=1)
    assert lowest.min() > 0 and np.median(lowest) < 0.04
    ways = [np.linalg.norm(one[-1, 0] - one[0, 0]) for one in (joints, motion.positions)]
    assert ways[0] / ways[1] == pytest.approx(0.95, abs=0.03)


def test_a_motion_of_smpls_joints_comes_back(tmp_path, motion):
    motion.save(tmp_path / "a.npz", names="smpl")
    own = Motion.load(tmp_path / "a.npz")
    own.save(tmp_path / "b.npz", names="smpl")
    again = Motion.load(tmp_path / "b.npz")
    assert again.fps == 20 and np.linalg.norm(again.positions - own.positions, axis=-1).max() < 5e-3
    lengths = np.linalg.norm(own.positions[:, 1:] - own.positions[:, HUMANML3D.parents[1:]], axis=-1)
    np.testing.assert_allclose(lengths, np.linalg.norm(OFFSETS[1:], axis=-1)[None].repeat(30, 0), atol=1e-5)


def test_files_of_other_programs_are_read(tmp_path, file, caplog):
    """Files for SMPL-X have more joints, older ones their texts as bytes, and some programs have Y up."""
    np.savez(tmp_path / "a.npz", **file)
    expected = Motion.load(tmp_path / "a.npz").positions
    others = {"poses": np.pad(file["poses"], ((0, 0), (0, 9))).astype("f4"), "gender": np.array(b"female")}
    np.savez(tmp_path / "b.npz", **file | others | {"betas": np.ones(10), "surface_model_type": "smplx"})
    with caplog.at_level(logging.INFO):
        np.testing.assert_allclose(Motion.load(tmp_path / "b.npz").positions, expected, atol=1e-4)
    assert "its betas are not used" in caplog.text
    clip = clip_from_smpl(file["poses"], file["trans"], fps=20.0)
    upright = clip.positions[..., [0, 2, 1]] * np.array((1, 1, -1), "f4")
    np.testing.assert_allclose(expected, upright, atol=1e-4)


@pytest.mark.parametrize("layout", ["parts", "rows", "aist"])
def test_other_layouts_of_rotations_are_read(tmp_path, file, layout):
    np.savez(tmp_path / "a.npz", **file)
    expected = Motion.load(tmp_path / "a.npz").positions
    poses, trans = file["poses"], file["trans"]
    archive = {
        "parts": {"root_orient": poses[:, :3], "pose_body": poses[:, 3:66], "trans": trans, "mocap_frame_rate": 20.0},
        "rows": {"poses": poses[:, :72].reshape(-1, 24, 3), "trans": trans, "fps": 20},
        "aist": {"smpl_poses": poses[:, :72], "smpl_trans": trans * 90, "smpl_scaling": np.full(1, 90.0), "fps": 20},
    }[layout]
    np.savez(tmp_path / "b.npz", **archive)
    motion = Motion.load(tmp_path / "b.npz")
    assert motion.fps == 20 and find_motion_files(tmp_path)[-1].name == "b.npz"
    np.testing.assert_allclose(motion.positions, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"poses": np.zeros((30, 63))}, r"entry 'poses' has shape \[30, 63\]; it needs \[frames, 66 or more\]"),
        ({"poses": np.array(1.0)}, r"entry 'poses' has shape \[\]; it needs"),
        ({"poses": np.zeros((0, 156))}, r"entry 'poses' has shape \[0, 156\]"),
        ({"poses": np.full((30, 156), np.nan)}, "entry 'poses' has other values than finite numbers"),
        ({"trans": np.zeros((29, 3))}, r"entry 'trans' has shape \[29, 3\]; it needs \[30, 3\]"),
        ({"trans": np.array(["x"] * 30)}, "entry 'trans' has other values"),
        ({"mocap_framerate": np.array(0.0)}, "entry 'mocap_framerate' is not one number above zero"),
        ({"mocap_framerate": None, "mocap_frame_rate": None}, "there is no entry 'mocap_framerate'"),
        ({"mocap_framerate": None, "mocap_frame_rate": None}, ".* or 'fps' with the frames per second"),
        ({"trans": None}, "there is no entry 'trans' or 'smpl_trans' with the places of the pelvis"),
        (
            {"poses": None},
            "there is no entry 'positions'; .* of SMPL are poses or root_orient and pose_body",
        ),
        ({"poses": np.zeros((30, 22, 3, 3))}, r"entry 'poses' has shape \[30, 22, 3, 3\]; it needs"),
        (
            {"poses": None, "root_orient": np.zeros((30, 3)), "pose_body": np.zeros((29, 63))},
            r"entry 'root_orient' has shape \[30, 3\] and 'pose_body' has shape \[29, 63\]; it needs \[frames, 66",
        ),
    ],
)
def test_what_is_wrong_is_named(tmp_path, file, change, message):
    np.savez(tmp_path / "a.npz", **{name: value for name, value in (file | change).items() if value is not None})
    with pytest.raises(UserError, match=rf"a\.npz: {message}"):
        Motion.load(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("places", "up"),
    [
        ([(0.0, 0.9, 0.1)], "z"),  # lies on the floor with the head toward +Y
        ([(0.0, 0.9 + step / 10, 0.1) for step in range(30)], "z"),  # slides along
        ([(0.0, 1.15, 0.0)], "y"),  # stands on the floor
        ([(0.3, 1.35, 0.5)], "y"),  # stands above it
    ],
)
def test_who_lies_along_y_is_not_raised(places, up):
    clip = clip_from_smpl(np.zeros((len(places), 156)), np.array(places), fps=20.0)
    assert up_of_smpl(clip) == up


def test_other_skeletons_are_refused(tmp_path, kit_walk):
    with pytest.raises(UserError, match="names smpl is for the skeleton humanml3d, not kit_ml"):
        kit_walk.save(tmp_path / "c.npz", names="smpl")
    assert not (tmp_path / "c.npz").exists()
