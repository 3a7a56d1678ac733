"""Paces and composed sentences on procedural motions whose speed and order are known."""

import dataclasses
import re

import numpy as np
import pytest

from t2m_jax.data import make_motion, open_dataset, write_synthetic_dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts import groups as prompt_groups
from t2m_jax.evaluation.prompts.following import RULES, requests
from t2m_jax.evaluation.prompts.groups import clip_speeds, composed_tests, pace_tests
from t2m_jax.evaluation.prompts.recognition import manner_tests
from t2m_jax.evaluation.prompts.sentences import held_out_paces
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import KIT_ML

CONTENTS = ("walk", "wave-left-hand")
COMPOSED = {test.name: test for test in composed_tests()}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "data"
    write_synthetic_dataset(folder, num_clips=60, seed=1)
    return open_dataset(folder)


@pytest.fixture
def tests_of_pace(dataset, monkeypatch):
    monkeypatch.setattr(prompt_groups, "PACED", CONTENTS)
    return {test.name: test for test in pace_tests(dataset)}


def limit(test):
    return float(re.search(r"([\d.]+) m/s", test.rule)[1])


def at_speed(speed):
    """Returns a walk along the heading at a given speed."""
    positions = make_motion("walk", seed=0, num_frames=60)
    across = positions[0, 1] - positions[0, 2]
    ahead = np.cross(across, [0.0, 1.0, 0.0]) / np.linalg.norm(across[[0, 2]])
    places = (speed * np.arange(60) / 20)[:, None] * ahead
    return Motion(positions - positions[:, :1] * [1, 0, 1] + places[:, None], 20.0)


@pytest.mark.slow
def test_limits_are_shares_of_real_clips(dataset, tests_of_pace):
    assert list(tests_of_pace) == [f"{content} {pace.name}" for content in CONTENTS for pace in held_out_paces()]
    slowest, slow, fast = (limit(tests_of_pace[f"walk {pace}"]) for pace in ("very slowly", "slowly", "fast"))
    assert 0 < slowest < slow < fast
    speeds = clip_speeds(dataset, CONTENTS)["walk"]
    shares = [pace.share for pace in held_out_paces()]
    np.testing.assert_allclose((slowest, slow, fast), np.quantile(speeds, shares), atol=6e-3)


@pytest.mark.slow
def test_speed_decides(tests_of_pace):
    slowest, slow, fast = (tests_of_pace[f"walk {pace}"] for pace in ("very slowly", "slowly", "fast"))
    between = at_speed((limit(slowest) + limit(slow)) / 2)
    assert [test.holds(between) for test in (slowest, slow, fast)] == [False, True, False]
    assert [test.holds(at_speed(limit(fast) + 0.3)) for test in (slowest, slow, fast)] == [False, False, True]
    assert not slow.holds(Motion(np.repeat(at_speed(1.0).positions[:1], 60, axis=0), 20.0)), "it stands"


@pytest.mark.slow
def test_sentences_say_how_fast(tests_of_pace):
    for name, test in tests_of_pace.items():
        phrases = next(pace.phrases for pace in held_out_paces() if name.endswith(f" {pace.name}"))
        assert len(test.sentences) >= 10
        assert all(sentence.endswith(phrases) for sentence in test.sentences)


@pytest.mark.slow
def test_a_content_without_clips_is_named(dataset):
    with pytest.raises(UserError, match="no training clip has the label 'run'"):
        pace_tests(dataset)


def in_turn(*kinds):
    """Returns one motion after the other, without a jump of the root."""
    parts, end = [], np.zeros(3)
    for kind in kinds:
        positions = make_motion(kind, seed=0, num_frames=60)
        positions = positions - positions[:1, :1] * [1, 0, 1] + end
        end = positions[-1, 0] * [1, 0, 1]
        parts.append(positions)
    return Motion(np.concatenate(parts), 20.0)


@pytest.mark.parametrize(
    "parts", [("walk", "wave-right-hand"), ("wave-left-hand", "walk"), ("walk", "raise-up-both-hands")]
)
def test_both_parts_in_order(parts):
    test = COMPOSED[" + ".join(parts)]
    assert test.holds(in_turn(*parts))
    assert not test.holds(in_turn(*parts[::-1]))
    assert not any(test.holds(in_turn(part)) for part in parts)
    assert not test.holds(Motion(in_turn(*parts).positions[:30], 20.0)), "too short for two parts"


def test_other_skeletons_are_refused():
    motion = Motion(np.zeros((60, 21, 3)), 12.5, skeleton=KIT_ML)
    for test in COMPOSED.values():
        with pytest.raises(UserError, match="the rules are for 'humanml3d', and the motion has 'kit_ml'"):
            test.holds(motion)


@pytest.mark.slow
def test_data_of_another_skeleton_are_refused(dataset):
    other = dataclasses.replace(dataset, skeleton=KIT_ML)
    for make_tests in (pace_tests, manner_tests):
        with pytest.raises(UserError, match="the rules are for 'humanml3d', and the data set has 'kit_ml'"):
            make_tests(other)


def test_there_are_enough_sentences_of_known_parts():
    assert len(COMPOSED) >= 10
    for test in COMPOSED.values():
        assert set(test.name.split(" + ")) <= set(RULES)
        assert len(set(test.sentences)) == len(test.sentences) >= 5
        assert len(requests(test, num_seeds=20)) == 20
