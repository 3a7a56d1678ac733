"""What sentences of another person ask for, by the rules for order, sides, numbers, hands and turns."""

from pathlib import Path

import pytest
import yaml

from t2m_jax.checkpoints.bundle import bundle_path, load_training_data
from t2m_jax.motion.repetitions import COUNTED_ACTIONS, SIDED_ACTIONS
from t2m_jax.text.at_once import said_at_once
from t2m_jax.text.counts import said_side, said_times
from t2m_jax.text.coverage import make_knowledge
from t2m_jax.text.directions import find_turn
from t2m_jax.text.sequence import split_sequence

SENTENCES = yaml.safe_load(Path(__file__).with_name("readings.yaml").read_text())


@pytest.fixture(scope="module")
def known():
    return make_knowledge(load_training_data(bundle_path("demo"))).actions


def count_of(sentence):
    said = said_times(sentence, COUNTED_ACTIONS)
    return said and said.number


def hands_of(sentence):
    hands = getattr(said_at_once(sentence), "hands", None) or (None,)
    return "both" if len(hands) == 2 else next(iter(hands))


def side_of(sentence):
    said = said_side(sentence, SIDED_ACTIONS)
    return said and said.side


@pytest.mark.parametrize(
    ("group", "wanted", "read", "right"),
    [
        ("counts", "count", count_of, 24),
        ("hands", "hands", hands_of, 24),
        ("turns", "half", lambda sentence: find_turn(sentence) is not None, 20),
        ("sides", "side", side_of, 24),
    ],
)
def test_what_is_said_is_read(group, wanted, read, right):
    found = [read(one["say"]) == one[wanted] for one in SENTENCES[group]]
    assert sum(found) >= right and len(found) == 24


def test_actions_in_turn_are_read(known):
    found = [len(split_sequence(one["say"], known)) == one["parts"] for one in SENTENCES["sequences"]]
    assert sum(found) >= 22 and len(found) == 24


def test_a_second_clause_names_its_part_of_the_body(known):
    cut = [(split_sequence(one["say"], known), one["last"]) for one in SENTENCES["other_side"]]
    found = [len(actions) == 2 and last in actions[1].lower() for actions, last in cut]
    assert sum(found) == len(found) == 24
