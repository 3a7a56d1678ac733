import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from t2m_jax.motion.inverse_kinematics import fit_rig
from t2m_jax.motion.kinematics import forward_kinematics, rigid_rotations
from t2m_jax.motion.rotations import matrix_from_euler, matrix_from_quaternion
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.motion.twist import limb_rotations

from .figures import INDEX, standing_offsets, turn_angles, walking_positions

PARENTS = HUMANML3D.parents
LEFT_ARM = {"rest_directions": np.array([[1.0, 0, 0]]), "hinge_axes": np.array([[0, -1.0, 0]])}


def random_rotations(seed: int, *shape: int) -> np.ndarray:
    return matrix_from_euler(np.random.default_rng(seed).uniform(-3, 3, (*shape, 3)), "XYZ")


def positions_of(rig) -> np.ndarray:
    return forward_kinematics(rig.rotations, rig.translations, PARENTS).positions


def mean_error(rig, positions: np.ndarray) -> float:
    return float(np.linalg.norm(positions_of(rig) - positions, axis=-1).mean())


def test_forward_kinematics_walks_down_the_tree():
    rotations, parents = random_rotations(0, 2, 5), (-1, 0, 1, 0, 3)
    translations = np.random.default_rng(1).normal(size=(2, 5, 3))
    poses = forward_kinematics(rotations, translations, parents)

    def transform(frame: int, joint: int) -> np.ndarray:
        own = np.eye(4)
        own[:3, :3], own[:3, 3] = rotations[frame, joint], translations[frame, joint]
        return own if parents[joint] < 0 else transform(frame, parents[joint]) @ own

    expected = np.array([[transform(frame, joint) for joint in range(5)] for frame in range(2)])
    np.testing.assert_allclose(poses.positions, expected[..., :3, 3], atol=1e-5)
    np.testing.assert_allclose(poses.rotations, expected[..., :3, :3], atol=1e-5)
    assert poses.positions.dtype == poses.rotations.dtype == np.float32


@given(st.integers(0, 10_000))
def test_rigid_rotations_finds_the_turn(seed):
    rest = np.random.default_rng(seed).normal(size=(4, 3))
    rotations = random_rotations(seed, 3)
    vectors = np.einsum("tij,nj->tni", rotations, rest)
    np.testing.assert_allclose(rigid_rotations(rest, vectors), rotations, atol=1e-4)


def test_rigid_rotations_never_mirrors():
    rest = np.eye(3)
    found = rigid_rotations(rest, -rest[None])
    np.testing.assert_allclose(np.linalg.det(found), 1, atol=1e-6)


def test_a_rigid_figure_is_met():
    positions = walking_positions()
    rig = fit_rig(positions, fps=20.0)
    assert mean_error(rig, positions) < 5e-4
    lengths = np.linalg.norm(rig.offsets, axis=-1)
    np.testing.assert_allclose(lengths[1:], HUMANML3D.bone_lengths[1:], atol=1e-5)
    np.testing.assert_allclose(np.linalg.det(rig.rotations), 1, atol=1e-5)
    leaves = [INDEX[name] for name in ("head", "left_wrist", "right_wrist", "left_foot", "right_foot")]
    np.testing.assert_allclose(rig.rotations[:, leaves], np.broadcast_to(np.eye(3), (60, 5, 3, 3)), atol=1e-6)


@pytest.mark.parametrize("length", [0.0, 0.002])
@pytest.mark.parametrize(
    "names", ["spine1", "spine1 spine2", "neck", "left_collar right_collar neck", "left_hip right_hip spine1"]
)
def test_a_figure_whose_bones_begin_at_one_place_is_met(names, length):
    walk = walking_positions()
    positions = walk.copy()
    for joint, name in enumerate(HUMANML3D.joint_names[1:], start=1):
        bone = walk[:, joint] - walk[:, PARENTS[joint]]
        short = length * bone / np.linalg.norm(bone, axis=-1, keepdims=True)
        positions[:, joint] = positions[:, PARENTS[joint]] + (short if name in names.split() else bone)
    rig = fit_rig(positions, fps=20.0)
    assert np.linalg.norm(positions_of(rig) - positions, axis=-1).max() < 5e-4
    # The hips are where they are, so nothing turns that did not turn before.
    assert turn_angles(rig.rotations).max() < 1.2 * turn_angles(fit_rig(walk, fps=20.0).rotations).max()


def test_a_noisy_figure_is_met_within_ten_millimetres():
    positions = walking_positions(100)
    noise = np.random.default_rng(0).normal(size=positions.shape)
    kernel = np.hanning(9) / np.linalg.norm(np.hanning(9))
    smooth = np.apply_along_axis(lambda column: np.convolve(column, kernel, mode="same"), 0, noise)
    rig = fit_rig(positions + 0.008 * smooth.astype(np.float32), fps=20.0)
    assert mean_error(rig, positions + 0.008 * smooth) < 0.010
    assert turn_angles(rig.rotations).max() < 60


def test_knees_and_elbows_turn_about_their_hinge_alone():
    rig = fit_rig(walking_positions(), fps=20.0)
    for name, axis in (("left_knee", 0), ("right_knee", 0), ("left_elbow", 1), ("right_elbow", 1)):
        rotation = rig.rotations[:, INDEX[name]]
        np.testing.assert_allclose(rotation[:, axis, axis], 1, atol=0.02, err_msg=name)
    # A knee folds the shin backwards: a positive turn about X takes -Y to -Z.
    assert np.all(rig.rotations[:, INDEX["left_knee"], 2, 1] > 0)


def straightening_arm(num_frames: int, *, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns upper and lower arm: bent, straight for a second while the hinge says nothing, bent again."""
    bend = np.clip(np.abs(np.linspace(-1.5, 1.5, num_frames)) - 0.4, 0, None)
    lift = np.linspace(0, 1.2, num_frames)
    upper = np.stack((np.cos(lift), np.sin(lift), np.zeros(num_frames)), axis=-1)
    lower = np.cos(bend)[:, None] * upper + np.sin(bend)[:, None] * np.array([0.0, 0.0, 1.0])
    lower = lower + noise * np.random.default_rng(3).normal(size=lower.shape)
    lower /= np.linalg.norm(lower, axis=-1, keepdims=True)
    return upper[:, None], lower[:, None]


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_an_arm_that_becomes_straight_does_not_flip(noise):
    upper, lower = straightening_arm(80, noise=noise)
    turns = matrix_from_quaternion(limb_rotations(upper, lower, **LEFT_ARM, fps=20.0))
    np.testing.assert_allclose(turns @ np.array([1.0, 0, 0]), upper, atol=1e-5)
    justified = np.rad2deg(1.2 / 79)
    assert turn_angles(turns).max() < justified + 3 + 60 * noise
    hinge = turns[:, 0] @ np.array([0.0, -1.0, 0.0])
    seen = np.cross(upper[:, 0], lower[:, 0])
    bent = np.linalg.norm(seen, axis=-1) > 0.5
    cosine = np.sum(hinge * seen, axis=-1)[bent] / np.linalg.norm(seen, axis=-1)[bent]
    assert cosine.min() > 0.98


def test_a_hinge_that_changes_its_plane_while_straight_turns_over_gradually():
    upper, lower = straightening_arm(80, noise=0.0)
    sideways = np.cross(lower[40:] - np.sum(lower[40:] * upper[40:], axis=-1, keepdims=True) * upper[40:], upper[40:])
    lower[40:] = np.sum(lower[40:] * upper[40:], axis=-1, keepdims=True) * upper[40:] + sideways
    turns = matrix_from_quaternion(limb_rotations(upper, lower, **LEFT_ARM, fps=20.0))
    assert turn_angles(turns).max() < 25
    hinge, seen = turns[:, 0] @ np.array([0.0, -1.0, 0.0]), np.cross(upper[:, 0], lower[:, 0])
    for frame in (0, -1):
        assert hinge[frame] @ seen[frame] / np.linalg.norm(seen[frame]) > 0.95


def test_an_arm_that_never_bends_keeps_its_natural_twist():
    upper, _ = straightening_arm(40, noise=0.0)
    turns = matrix_from_quaternion(limb_rotations(upper, upper, **LEFT_ARM, fps=20.0))
    # The arm only rises sideways, so the elbow's axis stays level with the ground.
    hinge = turns[:, 0] @ np.array([0.0, -1.0, 0.0])
    np.testing.assert_allclose(hinge[:, 2], 0, atol=1e-4)


def test_an_arm_that_points_across_the_body_does_not_whirl():
    # Past the direction opposite to rest, where the shortest swing from rest turns by half a turn at once.
    angle = np.linspace(np.pi - 0.6, np.pi + 0.6, 60)
    upper = np.stack((np.cos(angle), np.full(60, 0.02), np.sin(angle)), axis=-1)[:, None]
    upper /= np.linalg.norm(upper, axis=-1, keepdims=True)
    turns = matrix_from_quaternion(limb_rotations(upper, upper, **LEFT_ARM, fps=20.0))
    assert turn_angles(turns).max() < 5


def test_local_rotations_move_no_faster_than_the_bones():
    positions = walking_positions(fps=20.0)
    rig = fit_rig(positions, fps=20.0)
    bones = positions - positions[:, np.maximum(PARENTS, 0)]
    bones = bones[:, 1:] / np.linalg.norm(bones[:, 1:], axis=-1, keepdims=True)
    chord = np.linalg.norm(np.diff(bones, axis=0), axis=-1)
    fastest = np.rad2deg(2 * np.arcsin(chord / 2)).max()
    assert turn_angles(rig.rotations).max() < 1.5 * fastest


def test_a_moved_and_turned_figure_gets_the_same_rig():
    positions = walking_positions()
    turn = matrix_from_euler(np.array([0.0, 2.0, 0.0]), "XYZ")
    here, there = fit_rig(positions, fps=20.0), fit_rig(positions @ turn.T + np.float32([3, 0, -2]), fps=20.0)
    np.testing.assert_allclose(there.offsets, here.offsets, atol=1e-5)
    np.testing.assert_allclose(there.rotations[:, 1:], here.rotations[:, 1:], atol=2e-3)


@pytest.mark.parametrize("positions", [np.zeros((4, 22, 3)), np.ones((1, 22, 3)), standing_offsets()[None]])
def test_degenerate_figures_stay_finite(positions):
    rig = fit_rig(positions, fps=20.0)
    assert np.isfinite(rig.rotations).all()
    np.testing.assert_allclose(np.linalg.det(rig.rotations), 1, atol=1e-5)
