"""Motions that are cut or repeated so that they show an action as often as their sentence says."""

import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.sampling.choosing import SHORTEST_SECONDS, count_shown, fit_count
from t2m_jax.text.counts import Times

ROW = 8
"""Frames of a row of codes."""
BEAT = 32
"""Frames of one time."""
JOINTS = {"squat": ("pelvis", -0.4), "raise": ("left_wrist", 0.8)}


def shown(action, times):
    """Returns a figure that stands, and moves a joint up or down and back, `times` times."""
    joint, size = JOINTS[action]
    frames = BEAT * times + ROW
    still = make_motion("wave-left-hand", seed=0, num_frames=60)[:1].repeat(frames, axis=0)
    path = np.where(np.arange(frames) < BEAT * times, 1 - np.cos(2 * np.pi * np.arange(frames) / BEAT), 0) / 2
    still[:, HUMANML3D.joint_names.index(joint), 1] += size * path
    return still


def fitted(action, has, asked, most_rows=25):
    """Returns the rows of a motion that are left or repeated, and the motion that they are."""
    motion = shown(action, has)
    rows = np.arange(len(motion) // ROW)[:, None]
    times = Times(action, frozenset({"left", "right"}), asked)
    found = fit_count(rows, times, motion, downsample=ROW, most_rows=most_rows)
    new = motion.reshape(-1, ROW, *motion.shape[1:])[found[:, 0]].reshape(-1, *motion.shape[1:])
    return found[:, 0].tolist(), new, count_shown(times, new)


@pytest.mark.parametrize("asked", [1, 2, 3])
def test_a_motion_ends_after_the_last_time(asked):
    rows, motion, count = fitted("squat", 4, asked)
    assert count == asked and rows == list(range(len(rows)))
    assert len(motion) >= SHORTEST_SECONDS * HUMANML3D.fps
    pelvis = motion[:, 0, 1]
    assert pelvis[-1] > pelvis.max() - 0.1, "it ends in a squat"


@pytest.mark.parametrize(("most_rows", "count"), [(25, 5), (20, 3)])
def test_one_time_is_repeated_if_there_is_room(most_rows, count):
    _, motion, found = fitted("squat", 3, 5, most_rows)
    assert found == count
    assert np.abs(np.diff(motion[:, 0, 1])).max() < 0.05, "it jumps"


@pytest.mark.parametrize(
    ("action", "has", "asked"),
    [("squat", 3, 3), ("squat", 4, 0), ("squat", 1, 2), ("squat", 0, 2), ("raise", 4, 2)],
    ids=["right", "never", "one alone is not repeated", "not shown", "it would end with the hand up"],
)
def test_other_motions_stay(action, has, asked):
    rows, _, count = fitted(action, has, asked)
    assert count == has and rows == list(range(BEAT * has // ROW + 1))


def test_raised_hands_are_repeated():
    assert fitted("raise", 2, 4)[2] == 4
