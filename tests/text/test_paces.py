"""Slow and fast, in the words of sentences."""

from pathlib import Path

import pytest
import yaml

from t2m_jax.text.paces import said_pace
from t2m_jax.text.prompts import MAX_PROMPT_LENGTH

SENTENCES = yaml.safe_load(Path(__file__).with_name("paces.yaml").read_text())


def speed_of(caption):
    pace = said_pace(caption)
    return None if pace is None else "slow" if pace.is_slow else "fast"


@pytest.mark.parametrize(
    ("caption", "pace"),
    [
        ("a man walks", None),
        ("a man walks slowly", "slow"),
        ("walks fast", "fast"),
        ("a slow kick", "slow"),
        ("quick little steps", "fast"),
        ("walks in a slow and careful way", "slow"),
        ("walks at a gentle pace", "slow"),
        ("a slow walking motion", "slow"),
        ("a fast-paced walk", "fast"),
        ("walks around a fast-flowing stream", None),
        ("runs at top speed", "fast"),
        ("takes all the time in the world", "slow"),
        ("walks without hurrying", "slow"),
        ("walks in a great hurry", "fast"),
        ("crawls as slow as a tortoise", "slow"),
        ("crawls as fast as he can", "fast"),
        ("walks as if he were late", "fast"),
        ("he saunters along", "slow"),
        ("someone hurries along", "fast"),
        ("walks to a fast food restaurant", None),
        ("walks past slow traffic", None),
        ("jumps over a quickly spinning wheel", None),
        ("waves as the sun slowly sets", None),
        ("walks while the others run fast", None),
        ("walks, not too fast", None),
        ("isn't walking slowly", None),
        ("don't rush, walk normally", None),
        ("he walks and doesn't hurry", None),
        ("doesn’t run fast", None),
        ("walks without being in a hurry", None),
        ("walks slowly, then fast", None),
        ("walks and slows down", None),
        ("walks faster and faster", None),
        ("waves at a man who is walking slowly", None),
        ("a man of slow wits waves", None),
    ],
)
def test_a_sentence_says_how_fast_somebody_moves(caption, pace):
    assert speed_of(caption) == pace


@pytest.mark.parametrize(
    ("caption", "gait"),
    [
        ("walks fast", "walk"),
        ("sprints", "run"),
        ("slow steps", "walk"),
        ("waves fast", ""),
        ("walks or runs fast", ""),
    ],
)
def test_a_sentence_says_which_gait_is_fast(caption, gait):
    assert said_pace(caption).gait == gait


def test_paces_of_another_person_are_understood():
    found = {group: [speed_of(caption) for caption in captions] for group, captions in SENTENCES.items()}
    assert [len(paces) for paces in found.values()] == [45, 45, 30, 30]
    assert found["slow"].count("slow") >= 36 and found["fast"].count("fast") >= 39
    assert "fast" not in found["slow"] and "slow" not in found["fast"]
    assert found["none"].count(None) >= 28 and found["traps"].count(None) >= 29


@pytest.mark.parametrize(
    ("words", "pace"),
    [
        ("not slowly ", None),
        ("as the ", None),
        ("take time ", "slow"),
        ("at a ", None),
        ("in haste ", "fast"),
        ("who ", None),
    ],
)
def test_long_sentences_are_read(words, pace):
    assert speed_of((words * MAX_PROMPT_LENGTH)[:MAX_PROMPT_LENGTH]) == pace
