"""A classifier of actions on procedural motions, and the tests that it judges."""

import numpy as np
import pytest

from t2m_jax.data import make_motion, open_dataset, write_synthetic_dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts import free
from t2m_jax.evaluation.prompts import recognition as module
from t2m_jax.evaluation.prompts.recognition import action_clips, train_judge
from t2m_jax.motion.joining import join_positions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "data"
    write_synthetic_dataset(folder, num_clips=90, seed=1)
    return open_dataset(folder)


def motion_of(kind, seed, num_frames=60):
    return Motion(make_motion(kind, seed=seed, num_frames=num_frames), 20.0)


def test_new_motions_are_recognized(dataset):
    classifier, accuracy = train_judge(dataset)
    assert {"walk", "wave-left-hand"} <= set(classifier.classes)
    for kind in classifier.classes:
        assert sum(classifier.sees(kind, motion_of(kind, 1000 + seed)) for seed in range(5)) >= 4, kind
    assert np.mean(list(accuracy.values())) > 0.8
    assert not any(classifier.sees(kind, motion_of("walk", 0)[:1]) for kind in classifier.classes)


def test_actions_with_few_clips_are_not_learned(dataset, monkeypatch):
    counts = [content for content, _ in action_clips(dataset, "train")]
    most = max(map(counts.count, set(counts)))
    monkeypatch.setattr(module, "LEAST_CLIPS", most)
    assert set(train_judge(dataset)[0].classes) == {one for one in counts if counts.count(one) == most}
    monkeypatch.setattr(module, "LEAST_CLIPS", most + 1)
    with pytest.raises(UserError, match="no action has"):
        train_judge(dataset)


def test_sentences_of_the_actions_that_data_show(dataset):
    tests = {test.name: test for test in free.all_action_tests(dataset)}
    assert {"walk", "raise-up-left-hand"} <= set(tests) and "cartwheel" not in tests
    assert "of real test clips, " in tests["walk"].rule
    assert tests["walk"].holds(motion_of("walk", 7)) and not tests["walk"].holds(motion_of("wave-left-hand", 7))


def test_two_actions_in_turn_have_an_order(dataset):
    test = next(test for test in free.then_tests(dataset) if test.name == "walk + wave-right-hand")
    parts = [make_motion(kind, seed=3, num_frames=60) for kind in ("walk", "wave-right-hand")]
    joined = [join_positions(*pair, fps=20.0, skeleton=HUMANML3D) for pair in (parts, parts[::-1])]
    in_turn, reverse = (Motion(positions, 20.0) for positions in joined)
    assert test.holds(in_turn) and not test.holds(reverse)
