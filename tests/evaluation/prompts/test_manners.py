"""The classifier of manners on clips that differ in known ways."""

import numpy as np
import pytest

from t2m_jax.data import make_motion, open_dataset, write_synthetic_dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts import recognition
from t2m_jax.evaluation.prompts.following import evaluate_prompt_following
from t2m_jax.evaluation.prompts.recognition import MANNERS, manner_tests, train_classifier
from t2m_jax.motion import HUMANML3D, features_from_positions
from t2m_jax.motion.motion import Motion


def clip(manner, seed, *, frames=40):
    """Returns random features whose mean depends on the manner."""
    generator = np.random.default_rng((manner, seed))
    found = generator.standard_normal((frames, 12)).astype(np.float32)
    found[:, manner] += 1.5
    return found


def test_manners_are_recognized_in_new_clips():
    labels = np.repeat(np.arange(len(MANNERS)), 20)
    clips = [(MANNERS[manner], clip(manner, seed)) for seed, manner in enumerate(labels)]
    classifier = train_classifier(clips, classes=MANNERS)
    for manner, name in enumerate(MANNERS):
        assert [classifier.recognize(clip(manner, 1000 + seed)) for seed in range(5)] == [name] * 5


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "data"
    write_synthetic_dataset(folder, num_clips=20, seed=1)
    return open_dataset(folder)


@pytest.mark.slow
def test_without_labels_of_manners_it_is_refused(dataset):
    with pytest.raises(UserError, match="no clip of the split train has a label in the style 'normal'"):
        manner_tests(dataset)


@pytest.mark.slow
def test_each_manner_has_a_test_and_sentences(dataset, monkeypatch):
    """Each manner has the figure's size of its own, so real clips are told apart, and generated ones, too."""

    def labeled(_, split):
        return [
            (name, features_from_positions(motion(number, seed).positions, HUMANML3D))
            for number, name in enumerate(MANNERS)
            for seed in range(4)
        ]

    def motion(number, seed):
        positions = make_motion("wave-left-hand", seed=seed, num_frames=40)
        return Motion(positions * (0.8 + 0.1 * number), 20.0)

    monkeypatch.setattr(recognition, "_manner_clips", labeled)
    tests = manner_tests(dataset)
    assert [test.name for test in tests] == list(MANNERS[1:])
    assert all("of real test clips, it recognizes 100%" in test.rule for test in tests)
    assert all(len(set(test.sentences)) >= 20 for test in tests)
    results = evaluate_prompt_following(tests, lambda sentence, seed: motion(2, seed), num_seeds=3)
    assert [row.right for row in results] == [0, 3, 0, 0, 0, 0]
    assert results[0].instead == ((MANNERS[2], 3),)
    assert not tests[0].holds(Motion(motion(1, 0).positions[:1], 20.0))
