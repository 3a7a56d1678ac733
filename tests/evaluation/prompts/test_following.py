"""The kinematic rules on procedural motions whose content is known."""

import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import KINDS, make_motion
from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts.following import (
    RULES,
    action_tests,
    evaluate_prompt_following,
    follows,
    requests,
)
from t2m_jax.evaluation.prompts.results import following_table
from t2m_jax.evaluation.prompts.sentences import held_out_sentences
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import KIT_ML

OTHERS = (
    ("walk-turn-left", "walk-turn-right"),
    ("walk-turn-right", "walk-turn-left"),
    ("walk", "walk-turn-left"),
    ("wave-left-hand", "wave-right-hand"),
    ("wave-right-hand", "wave-left-hand"),
    ("wave-left-hand", "wave-both-hands"),
    ("wave-both-hands", "wave-left-hand"),
    ("raise-up-left-hand", "raise-up-right-hand"),
    ("raise-up-both-hands", "wave-both-hands"),
)


def motion_of(kind: str, seed: int) -> Motion:
    return Motion(make_motion(kind, seed=seed, num_frames=100), 20.0)


@pytest.mark.parametrize("kind", sorted(set(RULES) & set(KINDS)))
def test_motions_keep_their_own_rule(kind):
    assert sum(follows(kind, motion_of(kind, seed)) for seed in range(5)) >= 4


@pytest.mark.parametrize(("kind", "other"), OTHERS)
def test_motions_break_the_rule_of_another(kind, other):
    assert not any(follows(other, motion_of(kind, seed)) for seed in range(5))


def test_standing_still_follows_its_own_rule_alone():
    still = Motion(np.repeat(make_motion("walk", seed=0, num_frames=40)[:1], 40, axis=0), 20.0)
    assert [content for content in RULES if follows(content, still)] == ["stand"]


def test_other_skeletons_are_refused():
    motion = Motion(np.zeros((10, 21, 3)), 12.5, skeleton=KIT_ML)
    with pytest.raises(UserError, match=r"^skeleton: the rules are for 'humanml3d', and the motion has 'kit_ml'$"):
        follows("walk", motion)


def test_requests_cover_the_held_out_sentences():
    assert [test.name for test in action_tests()] == list(RULES)
    for test in action_tests():
        content, asked = test.name, requests(test, num_seeds=20)
        assert [seed for seed, _ in asked] == list(range(20))
        assert len({sentence for _, sentence in asked}) == 20
        assert {sentence for _, sentence in asked} <= set(held_out_sentences()[content])


def test_results_count_what_was_done():
    def generate(sentence: str, seed: int) -> Motion:
        return motion_of("walk", seed)

    results = evaluate_prompt_following(action_tests(), generate, num_seeds=3)
    assert [row.name for row in results] == list(RULES)
    right = {row.name: row.right for row in results}
    assert right["walk"] == 3
    assert right["wave-left-hand"] == 0
    row = next(row for row in results if row.name == "wave-left-hand")
    assert row.failures == held_out_sentences()["wave-left-hand"][:3]
    assert sum(dict(row.instead).values()) == 3 and set(dict(row.instead)) <= {"walk", "run"}  # whose speeds overlap
    total = sum(right.values())
    table = following_table(results)
    assert f"{total} of 33 ({total / 33:.0%})" in table
    assert len(table.splitlines()) == 2 + len(RULES) + 1
    assert "| 0 of 3 | " + ", ".join(f"{name} {count}" for name, count in row.instead) + " |" in table
