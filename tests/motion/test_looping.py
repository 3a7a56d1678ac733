"""Loops."""

import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.motion.features import bone_vectors
from t2m_jax.motion.looping import Loop, close_loop, find_loop
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML
from t2m_jax.motion.travel import above_origin

ARMS = [16, 17, 18, 19, 20, 21]


def make(kind="walk", *, num_frames=100):
    return Motion(make_motion(kind, seed=3, num_frames=num_frames), 20.0, caption=kind)


def periodic(num_frames=60, *, period=16, drift=0.0, speed=0.0):
    """A figure whose arms go around a circle of 20 cm; `drift` is their rise in meters per frame, `speed` in m/s."""
    positions = np.repeat(make("wave-left-hand").positions[:1], num_frames, axis=0)
    frames = np.arange(num_frames)[:, None]
    angle = 2 * np.pi * frames / period
    positions[:, ARMS, 1] += 0.2 * np.sin(angle) + drift * frames
    positions[:, ARMS, 2] += 0.2 * np.cos(angle)
    positions[:, :, 2] += speed * frames / 20
    return positions


def seam(positions, fps=20.0):
    """Largest differences over the joints, of the poses in place in millimeters, and of the velocities in m/s.

    The velocities are those at the seam, extrapolated from the frames before and from the frames after it: the
    difference of two neighboring frames would be half a frame away, where joints of a runner are 1 m/s faster.
    """
    local = above_origin(positions)
    apart, faster = 1000 * np.linalg.norm(local[-1] - local[0], axis=-1).max(), 0.0
    for frames in (local, positions):
        before, after = 3 * frames[-1] - 4 * frames[-2] + frames[-3], -3 * frames[0] + 4 * frames[1] - frames[2]
        faster = max(faster, np.linalg.norm(before - after, axis=-1).max() * fps / 2)
    return apart, faster


@pytest.mark.parametrize("speed", [0.0, 1.2])
def test_a_loop_is_whole_periods(speed):
    found = find_loop(periodic(speed=speed), fps=20.0)
    assert (found.end - found.start) % 16 == 0 and found.difference < 1e-3
    assert found.end - found.start == 48  # the longest


@pytest.mark.parametrize("kind", ["walk", "wave-left-hand", "squat"])
@pytest.mark.parametrize("fps", [30, 60])
def test_pose_and_velocities_agree_at_the_seam(kind, fps):
    loop = make(kind).resampled(fps).looped()
    apart, faster = seam(loop.positions, fps)
    assert apart < 0.01 and faster < 0.2
    assert seam(loop.in_place().positions, fps)[1] < 0.2
    lengths = np.linalg.norm(bone_vectors(loop.positions, HUMANML3D), axis=-1)
    np.testing.assert_allclose(lengths, lengths[:1].repeat(len(lengths), 0), rtol=1e-4)


def test_both_ends_approach_the_seam_in_half_a_second():
    positions = periodic(drift=0.002, speed=0.5)
    loop = find_loop(positions, fps=20.0)
    closed = close_loop(positions, loop, fps=20.0, skeleton=HUMANML3D)
    part = positions[loop.start : loop.end + 1]
    assert seam(part)[0] > 20 and seam(closed)[0] < 0.01
    np.testing.assert_allclose(closed[11:-11], part[11:-11], atol=1e-5)
    np.testing.assert_allclose(closed[-1, 0] - closed[0, 0], part[-1, 0] - part[0, 0], atol=1e-5)  # the same travel
    assert np.linalg.norm(np.diff(closed - part, n=2, axis=0), axis=-1).max() * 400 < 3  # m/s2 that are added


def test_velocities_that_differ_are_made_the_same():
    positions = make("wave-left-hand").resampled(60).positions
    closed = close_loop(positions, Loop(10, 130, 0.0), fps=60.0, skeleton=HUMANML3D)
    assert seam(positions[10:131], 60)[1] > 0.5 and seam(closed, 60)[1] < 0.1


def test_feet_that_stand_at_the_seam_stay_where_they_are():
    positions = periodic()
    legs = [1, 2, 4, 5, 7, 8, 10, 11]
    positions[:, [joint for joint in range(22) if joint not in legs], 0] += 0.001 * np.arange(60)[:, None]
    closed = close_loop(positions, find_loop(positions, fps=20.0), fps=20.0, skeleton=HUMANML3D)
    slide = np.linalg.norm(np.ptp(closed[:, [7, 8, 10, 11]][..., ::2], axis=0), axis=-1)
    assert np.ptp(positions[:, 0, 0]) > 0.05 and slide.max() < 0.01


def test_the_parts_of_a_motion_are_cut_alike():
    motion = make()
    both = Motion(motion.positions, 20.0, positions_raw=motion.positions + 1, caption="walks").looped()
    np.testing.assert_allclose(both.positions_raw, both.positions + 1, atol=1e-3)
    assert both.caption == "walks"


def test_what_does_not_repeat_is_refused():
    with pytest.raises(UserError, match=r"no part of the motion repeats; the most alike poses differ by 0\.\d\d m"):
        find_loop(periodic(drift=0.1), fps=20.0)
    with pytest.raises(UserError, match=r"the motion has 0.5 s; more than 0.6 s are needed"):
        make()[:10].looped()


def test_a_long_motion_is_searched_in_bounded_memory(monkeypatch):
    monkeypatch.setattr("t2m_jax.motion.looping.MOST_STARTS", 10)
    found = find_loop(periodic(), fps=20.0)
    assert found.start % 6 == 0 and (found.end - found.start) % 16 == 0


def test_loops_have_at_most_a_minute(monkeypatch):
    monkeypatch.setattr("t2m_jax.motion.looping.LONGEST_SECONDS", 2.0)
    found = find_loop(periodic(), fps=20.0)
    assert found.end - found.start == 32  # two periods of 16, and not three


def test_other_skeletons_loop():
    positions = np.repeat(make().positions[:1, :21], 60, axis=0)
    motion = Motion(positions, 12.5, skeleton=KIT_ML)
    assert motion.looped().num_frames == 60
