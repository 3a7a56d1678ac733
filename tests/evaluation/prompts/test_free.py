"""Tests with sentences that nobody tuned on: rules on motions that are known, and counts on real recordings."""

import numpy as np
import pytest

from t2m_jax.data.captioning.lexicon import read_words
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.evaluation.prompts import free
from t2m_jax.evaluation.prompts.counting import CURVES, count_action
from t2m_jax.evaluation.prompts.following import RULES, requests
from t2m_jax.motion.motion import Motion

PLAIN = {
    "free": free.free_tests,
    "subjects": free.subject_tests,
    "typos": free.typo_tests,
    "while": free.while_tests,
    "counts": free.count_tests,
    "durations": free.duration_tests,
}


def motion_of(kind, *, seed=0, num_frames=100):
    return Motion(make_motion(kind, seed=seed, num_frames=num_frames), 20.0)


def with_arms_of(legs, arms):
    """Returns the motion of `legs` with the arms of another, relative to the pelvis and its heading at the start."""
    positions = legs.positions.copy()
    upper = [
        legs.skeleton.joint_names.index(f"{side}_{part}") for side in ("left", "right") for part in ("elbow", "wrist")
    ]
    positions[:, upper] = arms.positions[:, upper] - arms.positions[:, :1] + positions[:, :1]
    return Motion(positions, 20.0)


@pytest.mark.parametrize("group", PLAIN)
def test_each_sentence_is_asked_with_four_seeds(group):
    tests = PLAIN[group]()
    assert len({test.name for test in tests}) == len(tests)
    for test in tests:
        asked = requests(test, num_seeds=None)
        assert len(asked) == len(set(asked)) == 4 * len(test.sentences)


@pytest.mark.parametrize("group", ["free", "subjects", "typos"])
def test_known_actions_keep_their_rule_alone(group):
    tests = {test.name: test for test in PLAIN[group]()}
    assert set(tests) == set(RULES) - {"stand"}
    assert tests["walk"].holds(motion_of("walk"))
    assert not tests["walk"].holds(motion_of("wave-left-hand"))


def test_every_subject_and_place_is_asked():
    sentences = [sentence for test in free.subject_tests() for sentence in test.sentences]
    groups = read_words("t2m_jax.evaluation.prompts", "held_out_groups")
    assert len(sentences) == len(set(sentences)) == 60
    for subject in groups["subjects"]:
        assert any(sentence.startswith(f"{subject} ") for sentence in sentences), subject
    for place in groups["places"]:
        assert any(sentence.endswith(f" {place}") for sentence in sentences), place


def test_legs_and_arms_are_both_needed():
    tests = {test.name: test for test in free.while_tests()}
    test = tests["walk while wave-right-hand"]
    walk, wave = motion_of("walk"), motion_of("wave-right-hand")
    both = with_arms_of(walk, wave)
    assert test.holds(both)
    assert not test.holds(walk) and not test.holds(wave)
    assert not tests["walk while wave-left-hand"].holds(both)
    assert not tests["run while wave-right-hand"].holds(both)
    assert not tests["walk while raise-both-hands"].holds(both)


def test_a_duration_is_kept_within_half_a_second():
    test = next(test for test in free.duration_tests() if test.name.startswith("walk, 5"))
    assert test.holds(motion_of("walk", num_frames=100)) and test.holds(motion_of("walk", num_frames=109))
    assert not test.holds(motion_of("walk", num_frames=130))
    assert not test.holds(motion_of("wave-left-hand", num_frames=100))


def raised(times):
    """Returns somebody who lifts the left hand above the shoulder and lowers it, `times` times."""
    still = motion_of("wave-left-hand").positions[:1].repeat(40 * times + 10, axis=0)
    names = list(motion_of("walk").skeleton.joint_names)
    wrist, shoulder = names.index("left_wrist"), names.index("left_shoulder")
    phase = np.arange(len(still)) / 40 * 2 * np.pi
    height = np.where(np.arange(len(still)) < 40 * times, -0.4 * np.cos(phase), -0.4)
    still[:, wrist, 1] = still[:, shoulder, 1] + height
    return Motion(still, 20.0)


@pytest.mark.parametrize("times", [0, 1, 3])
def test_peaks_are_counted(times):
    assert count_action("raise-up-left-hand", raised(times)) == times


def test_a_pose_that_is_held_to_the_end_counts_once():
    motion = raised(1)
    assert count_action("raise-up-left-hand", motion[:20]) == 1


def test_everything_that_sentences_count_has_a_curve():
    labels = {test.name.partition(" x ")[0] for test in free.count_tests()}
    assert {free.CONTENTS.get(label, label) for label in labels} <= set(CURVES)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("action", "number", "times"),
    [
        ("jump", 1, 5),
        ("jumping-jacks", 2, 5),
        ("punch", 4, 10),
        ("wave-right-hand", 6, 5),
        ("clap", 7, 5),
        ("throw", 8, 1),
        ("sit-down", 10, 1),
    ],
)
def test_people_who_repeat_an_action_are_counted(shared_data, shared_dir, action, number, times):
    """Berkeley MHAD asked people to do most of its actions five times."""
    from t2m_jax.motion.bvh import load_bvh
    from t2m_jax.motion.rig.retarget import retarget

    rig = f"{shared_dir / 'data' / 'rigs' / 'berkeley_mhad.yaml'}"
    files = sorted(shared_data("berkeley-mhad").rglob(f"*_a{number:02}_r01.bvh"))
    counts = [count_action(action, retarget(load_bvh(file).resampled(20.0), rig=rig)) for file in files]
    assert len(counts) >= 8 and np.mean(np.array(counts) == times) >= 0.6, counts
