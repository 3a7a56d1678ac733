"""How often something is done in a motion."""

import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.evaluation.prompts.counting import CURVES, count_action
from t2m_jax.motion.mirroring import mirror_positions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.repetitions import COUNTED_ACTIONS, SIGNALS, find_peaks
from t2m_jax.motion.skeleton import HUMANML3D

BEAT = 30
"""Frames of one time."""


def moved(joint, axis, size, times):
    """Returns a figure that stands, and moves a joint along an axis and back, `times` times."""
    frames = BEAT * times + 10
    still = make_motion("wave-left-hand", seed=0, num_frames=60)[:1].repeat(frames, axis=0)
    path = np.where(np.arange(frames) < BEAT * times, 1 - np.cos(2 * np.pi * np.arange(frames) / BEAT), 0) / 2
    for name in joint.split():
        still[:, HUMANML3D.joint_names.index(name), axis] += size * path
    return still


BODY = " ".join(HUMANML3D.joint_names)


@pytest.mark.parametrize("times", [0, 1, 2, 5])
@pytest.mark.parametrize(
    ("action", "joint", "axis", "size"),
    [
        ("jump", BODY, 1, 0.2),
        ("sit", "pelvis", 1, -0.4),
        ("bow", "head", 1, -0.4),
        ("kick", "right_ankle", 1, 0.6),
        ("raise", "left_wrist", 1, 0.8),
        ("punch", "right_wrist", 2, 0.6),
        ("throw", "left_wrist", 2, 0.6),
        ("jack", "left_wrist right_wrist", 1, 0.8),
    ],
)
def test_actions_are_counted(action, joint, axis, size, times):
    assert COUNTED_ACTIONS[action].count(moved(joint, axis, size, times)) == times


@pytest.mark.parametrize("steps", [2, 5])
def test_steps_are_counted(steps):
    frames = 12 * steps
    positions = make_motion("wave-left-hand", seed=0, num_frames=60)[:1].repeat(frames, axis=0)
    swing = 0.3 * np.sin(np.pi * np.arange(frames) / 12)
    for side, sign in (("left", 1), ("right", -1)):
        positions[:, HUMANML3D.joint_names.index(f"{side}_ankle"), 2] += sign * swing
    assert COUNTED_ACTIONS["step"].count(positions) == steps
    assert COUNTED_ACTIONS["step"].count(positions[:1].repeat(frames, axis=0)) == 0


def test_hands_that_meet_are_counted():
    positions = moved("left_wrist", 0, 0.0, 3)
    left, right = (HUMANML3D.joint_names.index(f"{side}_wrist") for side in ("left", "right"))
    apart = 0.25 * (1 + np.cos(2 * np.pi * np.arange(len(positions)) / BEAT))
    positions[:, left] = positions[:, right] + apart[:, None] * np.array([1.0, 0.0, 0.0])
    assert COUNTED_ACTIONS["clap"].count(positions) == 4, "they begin apart and end together"


def test_punches_of_both_hands_are_added_up_and_raised_hands_are_not():
    both = moved("left_wrist right_wrist", 2, 0.6, 2)
    assert COUNTED_ACTIONS["punch"].count(both) == 4
    assert COUNTED_ACTIONS["punch"].count(both, ["left"]) == 2
    assert COUNTED_ACTIONS["raise"].count(moved("left_wrist right_wrist", 1, 0.8, 2)) == 2


def waved(times):
    """Returns a figure that raises the right hand, swings it inward `times` times, and lowers it."""
    positions = moved("right_wrist", 0, 0.3, times)
    wrist = HUMANML3D.joint_names.index("right_wrist")
    shoulder = HUMANML3D.joint_names.index("right_shoulder")
    raised = slice(5, BEAT * times + 5)
    positions[:, wrist, 0] = positions[:, shoulder, 0] - 0.2 + (positions[:, wrist, 0] - positions[:1, wrist, 0])
    positions[raised, wrist, 1] = positions[raised, shoulder, 1] + 0.3
    return positions


@pytest.mark.parametrize("times", [1, 3])
def test_waves_of_either_hand_are_counted_alike(times):
    right = waved(times)
    left = mirror_positions(right, HUMANML3D)
    wave = COUNTED_ACTIONS["wave"]
    assert wave.count(right, ["right"]) == wave.count(left, ["left"]) == wave.count(left) == times
    counts = [count_action(f"wave-{side}-hand", Motion(one, 20.0)) for side, one in (("right", right), ("left", left))]
    assert counts == [times, times]


@pytest.mark.parametrize("action", sorted(CURVES))
def test_the_judge_counts_mirrored_motion_alike(action):
    other = {"left": "right", "right": "left"}
    twin = "-".join(other.get(word, word) for word in action.split("-"))
    for seed, kind in enumerate(("wave-left-hand", "walk", "squat")):
        positions = make_motion(kind, seed=seed, num_frames=80)
        mirrored = Motion(mirror_positions(positions, HUMANML3D), 20.0)
        assert count_action(action, Motion(positions, 20.0)) == count_action(twin, mirrored)


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_judge_counts_kicks_of_both_feet(side):
    assert count_action("kick", Motion(moved(f"{side}_ankle", 1, 0.8, 3), 20.0)) == 3


def test_small_peaks_beside_large_ones_do_not_count():
    values = np.array([0.0, 1.0, 0.0, 0.3, 0.0, 0.9, 0.0])
    assert find_peaks(values, least=0.1) == [1, 5]
    assert find_peaks(values * 0.09, least=0.1) == []


def test_every_action_has_a_signal():
    assert {action.signal for action in COUNTED_ACTIONS.values()} <= set(SIGNALS)
