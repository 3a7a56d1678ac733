import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.motion.features import bone_vectors, features_from_positions, positions_from_bones, positions_from_features
from t2m_jax.motion.inverse_kinematics import fit_rig
from t2m_jax.motion.joining import OVERLAP, Cut, ease_seams, fade_features, find_cut, join_features, replace_middle
from t2m_jax.motion.kinematics import forward_kinematics
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.motion.torso import hub_bones

from .figures import walking_positions


def features(num_frames):
    return features_from_positions(walking_positions(num_frames), HUMANML3D)


def test_a_clip_continues_itself():
    """Cut in two with an overlap and joined again, a clip is what it was."""
    whole = features(81)
    joined = join_features(whole[:50], whole[50 - OVERLAP :], Cut(50, 0, 0.0))
    np.testing.assert_allclose(joined, whole, atol=1e-6)


@pytest.mark.parametrize("fps", [0.5, 2.0, 2.5])
def test_motions_of_few_frames_a_second_are_joined(fps):
    """A fade would take less than a frame."""
    motion = Motion(walking_positions(40)[::5], fps)
    assert np.isfinite((motion + motion).positions).all()


def test_the_cut_is_where_the_poses_are_alike():
    """The walk repeats itself after 20 frames, but it goes straight on while its heading turns slowly."""
    whole = features(121)
    cut = find_cut(whole, whole[5:], ends=range(90, 121), starts=range(16), skeleton=HUMANML3D)
    assert (cut.end - OVERLAP - cut.start - 5) % 20 == 0
    worse = find_cut(whole, whole[5:], ends=range(90, 91), starts=range(1), skeleton=HUMANML3D)
    assert worse.cost > 1.5 * cut.cost


def test_a_join_is_as_smooth_as_the_clips():
    """From a walk into the same walk half a step later."""
    walk = features(121)
    cut = find_cut(walk, walk, ends=range(50, 71), starts=range(31), skeleton=HUMANML3D)
    joined = positions_from_features(join_features(walk, walk, cut), HUMANML3D)
    jerk = np.linalg.norm(np.diff(joined, 3, axis=0), axis=-1).mean(axis=1)
    around = slice(cut.end - OVERLAP - 3, cut.end)
    assert jerk[around].max() < 1.5 * np.median(jerk)
    assert np.linalg.norm(np.diff(joined[:, 0], axis=0), axis=-1).max() < 1.3 / 20 * 1.2


def test_clips_fade_into_each_other_and_keep_their_frames():
    first, second = (np.full((length, 3), value, np.float32) for length, value in ((20, 0.0), (30, 1.0)))
    faded = fade_features(first, second, overlap=8)
    assert [len(part) for part in faded] == [20, 30]
    joined, whole = np.concatenate(faded), np.concatenate([first, second])
    np.testing.assert_array_equal(np.delete(joined, range(16, 24), axis=0), np.delete(whole, range(16, 24), axis=0))
    middle = joined[15:25, 0]
    assert np.all(np.diff(middle) > 0) and np.diff(middle).max() < 0.2
    np.testing.assert_allclose(middle + middle[::-1], 1, atol=1e-6)


def test_short_clips_fade_in_fewer_frames():
    first, second = np.zeros((20, 3), np.float32), np.ones((5, 3), np.float32)
    before, after = fade_features(first, second, overlap=8)
    np.testing.assert_array_equal(before[:-2], first[:-2])
    np.testing.assert_array_equal(after[2:], second[2:])
    assert (before[-2:] > 0).all() and (after[:2] < 1).all()
    for one, other in zip(fade_features(first, second[:1], overlap=8), (first, second[:1]), strict=True):
        np.testing.assert_array_equal(one, other)


def test_only_seams_are_smoothed():
    positions = make_motion("walk", seed=2, num_frames=100)
    positions[50:] += 0.2
    eased = ease_seams(positions, [50], fps=20.0)
    np.testing.assert_array_equal(eased[:40], positions[:40])
    np.testing.assert_array_equal(eased[60:], positions[60:])

    def roughness(motion):
        return np.abs(np.diff(motion[40:60], n=2, axis=0)).max()

    assert roughness(eased) < roughness(positions) / 2
    assert ease_seams(positions, [], fps=20.0) is positions


def with_other_hubs(positions):
    """The same motion with a pelvis and a chest of another shape, which are rigid, too."""
    bones = bone_vectors(positions, HUMANML3D).astype(np.float64)
    lengths = np.linalg.norm(bones, axis=-1, keepdims=True)
    for left, right, above in hub_bones(HUMANML3D):
        leaning = np.cross(bones[:, left], bones[:, right])
        bones[:, above] += leaning * 0.4 * lengths[:, above] / np.linalg.norm(leaning, axis=-1, keepdims=True)
        bones[:, left] += 0.3 * bones[:, above]
    return positions_from_bones(positions[:, 0], unit_vectors(bones) * lengths, HUMANML3D).astype(np.float32)


@pytest.mark.parametrize(("first", "last"), [(20, 50), (0, 30), (40, 80)])
def test_a_new_middle_has_the_pelvis_and_the_chest_of_the_motion(first, last):
    """A file with a rotation for each joint, whose bones are rigid, then has the motion as it is."""
    motion, generated = walking_positions(80), with_other_hubs(walking_positions(80)[::-1])
    places = {"first": first, "last": last, "fps": 20.0, "skeleton": HUMANML3D}
    result = replace_middle(motion[:first], generated, motion[last:], **places)
    np.testing.assert_array_equal(result[:first], motion[:first])
    rig = fit_rig(result, fps=20.0)
    turned = forward_kinematics(rig.rotations, rig.translations, HUMANML3D.parents).positions
    assert np.linalg.norm(turned - result, axis=-1).max() < 1e-4
    # Nothing jumps, and the feet are between the same steps as without another pelvis.
    steps = np.linalg.norm(np.diff(result, axis=0), axis=-1)
    plain = replace_middle(motion[:first], walking_positions(80)[::-1], motion[last:], **places)
    assert steps.max() < 1.3 * np.linalg.norm(np.diff(plain, axis=0), axis=-1).max()
    feet = list(HUMANML3D.left_foot + HUMANML3D.right_foot)
    assert np.linalg.norm(result[first:last, feet] - plain[first:last, feet], axis=-1).max() < 0.05
