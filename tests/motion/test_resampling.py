"""Slices, other frame rates, mirror images and joins of motions."""

import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.motion.bvh import load_bvh
from t2m_jax.motion.features import facing
from t2m_jax.motion.rig.rigs import rig_joint_names
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML


def make(kind="walk", **fields):
    return Motion(make_motion(kind, seed=1, num_frames=60), 20.0, **fields)


def bone_lengths(motion):
    children = np.arange(1, 22)
    bones = motion.positions[:, children] - motion.positions[:, np.array(HUMANML3D.parents)[children]]
    return np.linalg.norm(bones, axis=-1)


def test_some_frames_of_a_motion():
    features = np.arange(60 * 263, dtype=np.float32).reshape(60, 263)
    motion = make(features=features, codes=np.zeros(15, int), caption="walks", seed=3)
    motion = Motion(
        motion.positions, 20.0, positions_raw=motion.positions + 1, features=features, caption="walks", seed=3
    )
    part = motion[20:50]
    assert part.num_frames == 30 and part.codes is None and (part.caption, part.seed) == ("walks", 3)
    np.testing.assert_array_equal(part.positions, motion.positions[20:50])
    np.testing.assert_array_equal(part.positions_raw, motion.positions_raw[20:50])
    np.testing.assert_array_equal(part.features, features[20:50])
    assert motion[-10:].num_frames == 10 and motion[:].num_frames == 60
    assert np.array([motion, motion], dtype=object).shape == (2,)


@pytest.mark.parametrize("frames", [3, slice(None, None, 2), slice(60, None), slice(5, 5), "a"])
def test_frames_that_are_no_range_are_refused(frames):
    with pytest.raises(UserError, match=r"motion\["):
        make()[frames]


def test_rotations_give_the_positions_again(tmp_path):
    motion = make()
    motion.save(tmp_path / "a.bvh")
    clip = load_bvh(tmp_path / "a.bvh")
    order = [clip.joint_names.index(name) for name in rig_joint_names("lafan1")]
    np.testing.assert_allclose(motion.rotations, clip.rotations[:, order], atol=1e-3)
    with pytest.raises(UserError, match="rotations"):
        Motion(np.zeros((4, 21, 3)), 20.0, skeleton=KIT_ML).rotations  # noqa: B018 - the property is what is tested


def test_speed_1_changes_nothing():
    motion = make()
    np.testing.assert_array_equal(motion.at_speed(1).positions, motion.positions)


@pytest.mark.parametrize("factor", [0.5, 0.8, 2.0])
def test_a_motion_at_another_speed_has_its_poses_at_other_times(factor):
    motion = make("wave-both-hands").resampled(60)
    fast = motion.at_speed(factor)
    assert fast.fps == 60 and abs(fast.num_frames - motion.num_frames / factor) <= 2
    np.testing.assert_allclose(bone_lengths(fast) - bone_lengths(motion)[0], 0, atol=1e-5)
    sources = np.arange(fast.num_frames) * factor
    whole = np.isclose(sources, np.round(sources))
    np.testing.assert_allclose(fast.positions[whole], motion.positions[np.round(sources[whole]).astype(int)], atol=0.02)
    back = fast.at_speed(1 / factor)
    shared = min(back.num_frames, motion.num_frames)
    np.testing.assert_allclose(back.positions[:shared], motion.positions[:shared], atol=0.02)


def test_parts_of_a_motion_keep_their_sentences_at_another_speed():
    motion = make(part_starts=(0, 30), part_captions=("walks", "waves"), positions_raw=make().positions)
    slow = motion.at_speed(0.5)
    assert (slow.part_starts, slow.part_captions) == ((0, 60), ("walks", "waves"))
    assert slow.positions_raw.shape == slow.positions.shape
    short = make(part_starts=(0, 58), part_captions=("walks", "waves")).at_speed(10)  # the second part has no frame
    assert (short.part_starts, short.part_captions) == ((), ())


@pytest.mark.parametrize("factor", [0.0, -1.0, 0.05, 11, float("nan"), float("inf")])
def test_impossible_speeds_are_refused(factor):
    with pytest.raises(UserError, match=r"speed: .* is not a number from 0\.1 to 10"):
        make().at_speed(factor)


@pytest.mark.parametrize("fps", [24, 30, 60, 12.5])
def test_bones_stay_as_long_at_another_frame_rate(fps):
    motion = make("wave-both-hands")
    expected = bone_lengths(motion)[0]
    np.testing.assert_allclose(bone_lengths(motion.resampled(fps)) - expected, 0, atol=1e-5)


def test_another_frame_rate_and_back():
    motion = make(caption="walks")
    double = motion.resampled(40)
    assert (double.num_frames, double.fps, double.caption) == (119, 40.0, "walks")
    np.testing.assert_allclose(double.positions[::2], motion.positions, atol=1e-5)
    np.testing.assert_allclose(bone_lengths(double), bone_lengths(motion).mean(axis=0)[None].repeat(119, 0), rtol=0.02)
    assert motion.resampled(20.0).num_frames == 60
    assert motion[:1].resampled(60).num_frames == 1


def test_fast_vibrations_do_not_become_slow_ones():
    still = np.broadcast_to(make_motion("walk", seed=1, num_frames=1), (240, 22, 3)).copy()
    still[:, :, 0] += 0.05 * np.sin(2 * np.pi * 19 * np.arange(240) / 60)[:, None]  # 19 Hz would be 1 Hz at 20 a second
    found = Motion(still, 60.0).resampled(20).positions
    assert np.abs(found - found.mean(axis=0))[5:-5].max() < 0.1 * 0.05


@pytest.mark.parametrize("fps", [0, -1, float("nan"), float("inf"), 10_000])
def test_rates_that_cannot_be_are_refused(fps):
    with pytest.raises(UserError, match="fps"):
        make().resampled(fps)


def test_the_mirror_image():
    motion = make(caption="a man raises the left hand")
    mirrored = motion.mirrored()
    assert mirrored.caption == "a man raises the right hand"
    left, right = HUMANML3D.joint_names.index("left_wrist"), HUMANML3D.joint_names.index("right_wrist")
    np.testing.assert_allclose(mirrored.positions[:, left] * [-1, 1, 1], motion.positions[:, right])
    np.testing.assert_array_equal(mirrored.mirrored().positions, motion.positions)


def test_a_motion_goes_on_where_another_ends():
    first, second = make("walk-turn-left", caption="turns"), make("walk", caption="walks")
    joined = first + second
    assert joined.num_frames == 119 and joined.caption == "turns, then walks"
    np.testing.assert_array_equal(joined.positions[:60], first.positions)
    heading = facing(joined.positions[-1], HUMANML3D)
    expected = facing(first.positions[-1], HUMANML3D)
    cosine = heading @ expected / np.linalg.norm(heading) / np.linalg.norm(expected)
    assert cosine > 0.9, "the second one is turned"
    speeds = np.linalg.norm(np.diff(joined.positions, axis=0), axis=-1)
    both = [np.linalg.norm(np.diff(one.positions, axis=0), axis=-1).max() for one in (first, second)]
    assert speeds[55:75].max() < 1.5 * max(both) + 0.02
    np.testing.assert_allclose(  # after the blend, it is the second motion
        np.diff(joined.positions[80:, :, 1], axis=0), np.diff(second.positions[21:, :, 1], axis=0), atol=1e-5
    )
    assert (make() + make()).positions_raw is None


def test_motions_that_cannot_be_joined_are_refused():
    with pytest.raises(UserError, match="40 and 20 frames a second cannot be joined"):
        make().resampled(40) + make()
    with pytest.raises(UserError, match=r"\(humanml3d and kit_ml\) cannot be joined"):
        make() + Motion(np.zeros((4, 21, 3)), 20.0, skeleton=KIT_ML)
    with pytest.raises(TypeError):
        make() + 3
