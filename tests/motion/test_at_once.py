"""What legs and arms do at the same time."""

import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import KINDS, make_motion
from t2m_jax.motion.at_once import LEGS, arms_do
from t2m_jax.motion.facts import measure
from t2m_jax.motion.mirroring import mirror_positions
from t2m_jax.motion.skeleton import HUMANML3D, JOINT

FPS = 20.0
HANDS = {"any": (), "left": ("left",), "right": ("right",), "both": ("left", "right")}


def legs_of(positions):
    return {legs for legs, holds in LEGS.items() if holds(measure(positions, fps=FPS))}


def arms_of(positions, actions=("raise", "wave")):
    return {(one, name) for one in actions for name, own in HANDS.items() if arms_do(one, own, positions) == 1}


@pytest.mark.parametrize("kind", KINDS)
def test_legs_do_one_thing(kind):
    expected = {"walk": {"walk"}, "walk-turn-left": {"left"}, "walk-turn-right": {"right"}}
    assert legs_of(make_motion(kind, seed=1, num_frames=80)) == expected.get(kind, set())


def test_a_gait_has_a_speed_and_a_direction():
    walk = make_motion("walk", seed=1, num_frames=80)
    assert legs_of(walk[::2]) == {"walk", "run"}, "2 m/s may be either"
    assert legs_of(walk[::3]) == {"run"}
    assert legs_of(walk[::-1]) == {"backward"}


@pytest.mark.parametrize("hands", ["left", "right", "both"])
def test_raised_hands_are_those_that_are_asked_for(hands):
    name = f"{hands}-hands" if hands == "both" else f"{hands}-hand"
    raised = {("raise", "any"), ("raise", hands)}
    assert arms_of(make_motion(f"raise-up-{name}", seed=1, num_frames=80)) == raised
    waved = make_motion(f"wave-{name}", seed=1, num_frames=80)
    assert arms_of(waved) == raised | {("wave", "any"), ("wave", hands)}
    other = {"left": "right", "right": "left", "both": "both"}[hands]
    assert ("wave", other) in arms_of(mirror_positions(waved, HUMANML3D))


@pytest.mark.parametrize("hands", ["left", "both"])
def test_a_hand_that_is_up_for_a_moment_counts_less(hands):
    name = f"{hands}-hands" if hands == "both" else f"{hands}-hand"
    positions = make_motion(f"wave-{name}", seed=1, num_frames=80)
    later = np.concatenate([positions[:1].repeat(400, axis=0), positions])
    for own in (HANDS[hands], ()):
        assert arms_do("wave", own, positions) == 1 and arms_do("wave", own, later) == pytest.approx(2 / 3)
        assert arms_do("wave", own, later[:400]) == 0


def test_the_other_hand_may_swing_but_is_not_raised():
    positions = make_motion("raise-up-left-hand", seed=1, num_frames=80)
    top = positions[:, JOINT["left_wrist"], 1].max() - positions[0, JOINT["left_shoulder"], 1]
    scores = []
    for height in (-0.4, -0.05, top - 0.1):
        positions[40, JOINT["right_wrist"], 1] = positions[40, JOINT["right_shoulder"], 1] + height
        scores.append(arms_do("raise", ["left"], positions))
    assert scores == pytest.approx([1, 2 / 3, 0])


def swung(forward, height):
    """Returns a figure that stretches the left arm ahead and back, twice."""
    positions = make_motion("raise-up-left-hand", seed=1, num_frames=80)[:1].repeat(80, axis=0)
    swing = (1 - np.cos(np.arange(80) * 2 * np.pi / 40)) / 2
    shoulder = positions[:, JOINT["left_shoulder"]]
    positions[:, JOINT["left_wrist"]] = shoulder + np.stack([0 * swing, height + 0 * swing, forward * swing], axis=1)
    return positions


def test_swinging_arms_do_not_punch():
    assert arms_of(swung(0.5, -0.1), ["punch"])
    assert not arms_of(swung(0.5, -0.4), ["punch"]), "as in a walk"
    assert not arms_of(swung(0.1, -0.1), ["punch"])


def test_hands_that_meet_clap():
    positions = swung(0.4, -0.3)
    clap = positions.copy()
    clap[:, JOINT["right_wrist"]] = positions[:40].mean(axis=0)[JOINT["left_wrist"]]
    apart = np.abs(np.sin(np.arange(80) * np.pi / 20))[:, None] * np.array([0.5, 0.0, 0.0])
    clap[:, JOINT["left_wrist"]] = clap[:, JOINT["right_wrist"]] + apart
    assert arms_of(clap, ["clap"]) and not arms_of(positions, ["clap"])
