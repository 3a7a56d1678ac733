"""Directions, roots, poses, wrists and feet that are brought exactly to their targets."""

import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.motion.features import bone_vectors, ground_positions
from t2m_jax.motion.joining import place_positions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.reaching import check_exact, faded, limbs_of, reach_exactly
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML
from t2m_jax.motion.targets import distances, read_target, seen_from_root, targets_from_text
from t2m_jax.motion.torso import hub_bones

JOINTS = ("left_wrist", "right_wrist", "left_ankle", "right_ankle", "left_foot", "right_foot")


@pytest.fixture(scope="module")
def walk():
    return Motion(ground_positions(make_motion("walk", seed=1, num_frames=60), HUMANML3D), 20.0)


def near(motion, joint, frame, way=(0.02, 0.03, -0.02)):
    """Returns the text of an exact target some centimeters from where a joint is."""
    place = motion.positions[frame, HUMANML3D.joint_names.index(joint)] + np.array(way)
    return f"{frame / 20} {joint}={','.join(map(str, place))} exact"


@pytest.mark.parametrize("joint", JOINTS)
def test_a_limb_reaches_its_target_and_nothing_else_moves(walk, joint):
    targets = targets_from_text(near(walk, joint, 30))
    reached = reach_exactly(walk, targets)
    assert distances(walk, targets)[0] > 0.03 and distances(reached, targets)[0] < 1e-3
    moved = np.abs(reached.positions - walk.positions).max(axis=-1)
    limb = {"left_wrist": (18, 20), "right_wrist": (19, 21)}.get(joint, (4, 7, 10) if "left" in joint else (5, 8, 11))
    assert not np.delete(moved, limb, axis=1).any()
    assert not moved[:21].any() and not moved[40:].any()
    lengths = [np.linalg.norm(bone_vectors(one.positions, HUMANML3D), axis=-1) for one in (walk, reached)]
    np.testing.assert_allclose(*lengths, atol=1e-4)


def test_a_root_takes_the_body_along(walk):
    x, _, z = walk.positions[30, 0]
    targets = targets_from_text(f"1.5 root={x + 0.1},{z - 0.05} exact; {near(walk, 'left_wrist', 32)}")
    reached = reach_exactly(walk, targets)
    assert max(distances(reached, targets)) < 1e-3
    np.testing.assert_allclose(reached.positions[30, 7] - walk.positions[30, 7], [0.1, 0, -0.05], atol=1e-5)


def test_a_place_may_be_seen_from_the_root(walk):
    seen = seen_from_root(walk.positions, HUMANML3D)[30, 20] + np.array([0.0, 0.03, 0.02])
    targets = targets_from_text(f"1.5 left_wrist+={','.join(map(str, seen))} exact")
    assert distances(reach_exactly(walk, targets), targets)[0] < 1e-3


def test_targets_of_one_joint_and_spans_are_all_met(walk):
    texts = [near(walk, "left_wrist", frame, way) for frame, way in ((20, (0, 0.05, 0)), (26, (0, 0.03, 0.02)))]
    texts += [near(walk, "right_wrist", 10, (0, 0.06, 0)).replace("0.5 ", "0.5:0.6 ")]
    targets = targets_from_text(";".join(texts))
    assert max(distances(reach_exactly(walk, targets), targets)) < 2e-3


@pytest.fixture(scope="module")
def wave():
    return Motion(ground_positions(make_motion("wave-both-hands", seed=2, num_frames=60), HUMANML3D), 20.0)


@pytest.mark.parametrize("degrees", [25.0, -200.0, 750.0])
def test_a_figure_turns_about_its_root(walk, degrees):
    targets = targets_from_text(f"1.5 facing={degrees} exact")
    reached = reach_exactly(walk, targets)
    assert distances(walk, targets)[0] > 5 and distances(reached, targets)[0] < 1e-2
    np.testing.assert_allclose(reached.positions[:, 0], walk.positions[:, 0], atol=1e-6)
    np.testing.assert_array_equal(reached.positions[40:], walk.positions[40:])


def test_bones_turn_into_a_pose_and_keep_lengths(walk, wave):
    targets = [read_target((1.5, wave[25:26], "exact"))]
    reached = reach_exactly(walk, targets)
    assert distances(walk, targets)[0] > 0.1 and distances(reached, targets)[0] < 1e-4
    # Pelvis and chest get the shapes of the pose, which differ by millimeters in made motions. All else stays.
    others = np.delete(reached.positions - walk.positions, np.s_[21:40], axis=0)
    assert np.abs(others).max() < 0.01
    lengths = [np.linalg.norm(bone_vectors(one.positions, HUMANML3D), axis=-1) for one in (walk, reached)]
    np.testing.assert_allclose(*lengths, atol=1e-5)


def test_pelvis_and_chest_stay_rigid(walk, wave):
    targets = [read_target((time, pose, "exact")) for time, pose in ((0.5, wave[25:26]), (1.5, wave[25:26]))]
    bones = bone_vectors(reach_exactly(walk, targets).positions, HUMANML3D)
    for hub in hub_bones(HUMANML3D):
        products = bones[:, hub] @ bones[:, hub].swapaxes(1, 2)
        np.testing.assert_allclose(products, np.broadcast_to(products[0], products.shape), atol=1e-5)


def test_poses_with_a_place_and_a_direction_are_met_in_the_world(walk, wave):
    begin, end = wave[5:6], wave[40:41]
    targets = [
        *targets_from_text("2 root=0.3,1.5 exact; 2 facing=40 exact"),
        read_target((0.0, begin, "exact")),
        read_target((2.0, end, "exact")),
    ]
    reached = reach_exactly(walk, targets)
    assert max(distances(reached, targets)) < 1e-2 and distances(reached, targets)[2] < 1e-4
    placed = place_positions(end.positions, end.positions[0], reached.positions[40], skeleton=HUMANML3D)
    np.testing.assert_allclose(reached.positions[40], placed[0], atol=1e-3)
    assert np.abs(np.diff(reached.positions, n=2, axis=0)).max() < 0.1


def test_a_limb_goes_on_from_an_exact_pose(walk, wave):
    targets = [read_target((1.5, wave[25:26], "exact")), *targets_from_text("1.5 left_wrist+=0.25,1.2,0.3 exact")]
    assert distances(reach_exactly(walk, targets), targets)[1] < 1e-3


def test_changes_go_smoothly():
    shifts = faded({10: np.array([1.0, 0, 0]), 14: np.array([0, 1.0, 0]), 60: np.array([0, 0, 1.0])}, 80, fade=10)
    np.testing.assert_allclose(shifts[[0, 10, 14, 24, 30, 50, 60, 70]].sum(axis=1), [0, 1, 1, 0, 0, 0, 1, 0], atol=1e-9)
    assert np.abs(np.diff(shifts[14:], axis=0)).max() < np.pi / 20


def test_others_stay_as_they_are(walk):
    assert reach_exactly(walk, targets_from_text("1 left_wrist=0,1,0; 1 root=0,0")) is walk


@pytest.mark.parametrize("joint", ["head", "left_knee"])
def test_what_cannot_be_exact_is_refused(joint):
    with pytest.raises(UserError, match="cannot be exact; these can: root, facing, pose, right_wrist"):
        check_exact(targets_from_text(f"1 {joint}=0,1,0 exact"), HUMANML3D)


def test_other_skeletons_have_limbs():
    limbs = limbs_of(KIT_ML)
    assert sorted(limbs) == ["LF", "LMrot", "LW", "RF", "RMrot", "RW"]  # toes, ankles and wrists
    check_exact(targets_from_text("1 root=0,0 exact"), KIT_ML)
