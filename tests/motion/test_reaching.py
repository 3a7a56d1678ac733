"""Roots, wrists and feet that are brought exactly to their targets."""

import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.motion.features import bone_vectors, ground_positions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.reaching import check_exact, faded, reach_exactly
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML
from t2m_jax.motion.targets import distances, seen_from_root, targets_from_text

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


def test_shifts_change_smoothly():
    shifts = faded({10: np.array([1.0, 0, 0]), 14: np.array([0, 1.0, 0]), 60: np.array([0, 0, 1.0])}, 80, fade=10)
    np.testing.assert_allclose(shifts[[0, 10, 14, 24, 30, 50, 60, 70]].sum(axis=1), [0, 1, 1, 0, 0, 0, 1, 0], atol=1e-9)
    assert np.abs(np.diff(shifts[14:], axis=0)).max() < np.pi / 20 and not faded({}, 5, fade=10).any()


def test_others_stay_as_they_are(walk):
    assert reach_exactly(walk, targets_from_text("1 left_wrist=0,1,0; 1 root=0,0")) is walk


@pytest.mark.parametrize("text", ["1 head=0,1.5,0 exact", "1 facing=30 exact", "1 pose=0,0,0 exact"])
def test_what_cannot_be_exact_is_refused(text):
    with pytest.raises(UserError, match="cannot be exact; these can: root, "):
        check_exact(targets_from_text(text), HUMANML3D)


def test_other_skeletons_have_limbs():
    check_exact(targets_from_text("1 root=0,0 exact"), KIT_ML)
