import dataclasses

import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.motion.rig import RigClip
from t2m_jax.motion.rotations import euler_from_matrix, matrix_from_euler
from tests.motion.figures import turn_angles


def turning_clip(num_frames: int, fps: float, *, start: float = 0.0) -> RigClip:
    """Returns a root that turns by one radian a second about Y and moves by one metre a second along Z."""
    time = np.arange(num_frames) / fps
    angles = np.zeros((num_frames, 1, 3))
    angles[..., 0] = start + time[:, None]
    translations = np.zeros((num_frames, 1, 3), dtype=np.float32)
    translations[:, 0, 2] = time
    return RigClip(
        joint_names=("Hips",),
        parents=(-1,),
        offsets=np.zeros((1, 3), dtype=np.float32),
        rotations=matrix_from_euler(angles, "YXZ"),
        translations=translations,
        fps=float(fps),
        metres_per_unit=1.0,
    )


@pytest.mark.parametrize(
    ("source", "target", "frames", "expected"),
    [
        *((30, 20, 31, 21), (30, 20, 32, 21), (60, 20, 61, 21), (60, 20, 60, 20), (120, 20, 343, 58), (20, 30, 21, 31)),
        *((30, 20, 1, 1), (30, 12.5, 100, 42), (59.94, 20, 600, 200), (30, 30, 7, 7)),
    ],
)
def test_frame_k_is_the_pose_at_its_time(source, target, frames, expected):
    clip = turning_clip(frames, source).resampled(float(target))
    assert clip.num_frames == expected
    assert clip.fps == target
    time = np.arange(expected) / target
    assert time[-1] <= (frames - 1) / source + 1e-6 < time[-1] + 1 / target
    np.testing.assert_allclose(clip.translations[:, 0, 2], time, atol=1e-5)
    angles = np.unwrap(euler_from_matrix(clip.rotations, "YXZ")[:, 0, 0])
    np.testing.assert_allclose(angles, time, atol=1e-5)


def test_slow_motion_is_kept_where_frames_coincide():
    clip = turning_clip(61, 60)
    np.testing.assert_allclose(clip.resampled(20.0).rotations, clip.rotations[::3], atol=1e-5)
    assert clip.resampled(60.0) is clip


def test_new_frames_between_old_ones_are_as_lively_as_those_that_coincide():
    swing = np.zeros((300, 1, 3))
    swing[:, 0, 0] = 0.8 * np.sin(2 * np.pi * 3.7 * np.arange(300) / 30)
    clip = dataclasses.replace(turning_clip(300, 30), rotations=matrix_from_euler(swing, "YXZ"))
    angles = euler_from_matrix(clip.resampled(20.0).rotations, "YXZ")[5:-5, 0, 0]
    changes = np.abs(np.diff(angles, 2))
    assert changes[0::2].mean() == pytest.approx(changes[1::2].mean(), rel=0.03)  # straight lines between frames: 0.12


def test_angles_that_wrap_do_not_pass_through_the_far_side():
    clip = turning_clip(30, 30, start=np.pi - 0.5).resampled(20.0)
    assert turn_angles(clip.rotations).max() < np.rad2deg(1 / 20) + 1e-3


def test_gimbal_flips_of_the_source_do_not_matter():
    # The same motion with angles that flip between two triples of one rotation, as files from mocap tools do.
    angles = np.zeros((31, 1, 3))
    angles[:, 0] = np.linspace((0.2, 1.4, 0.1), (0.4, 1.75, 0.2), 31)
    flipped = angles.copy()
    flipped[::2] = flipped[::2] * (1, -1, 1) + np.pi
    base = turning_clip(31, 30)
    smooth, flipping = (
        dataclasses.replace(base, rotations=matrix_from_euler(a, "ZXY")).resampled(20.0) for a in (angles, flipped)
    )
    np.testing.assert_allclose(flipping.rotations, smooth.rotations, atol=1e-5)


@pytest.mark.parametrize("fps", [0.0, -20.0, float("nan"), float("inf")])
def test_impossible_rates_are_refused(fps):
    with pytest.raises(UserError, match="frames per second"):
        turning_clip(5, 30).resampled(fps)
