"""Clauses that mean something only together with the one before."""

import re
from pathlib import Path

import pytest
import yaml

from t2m_jax.checkpoints.bundle import bundle_path, load_training_data
from t2m_jax.text.clauses import fill_in, name_part, only_ends
from t2m_jax.text.coverage import make_knowledge
from t2m_jax.text.sequence import split_sequence

SENTENCES = yaml.safe_load(Path(__file__).with_name("clauses.yaml").read_text())


@pytest.fixture(scope="module")
def known():
    return make_knowledge(load_training_data(bundle_path("demo"))).actions


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("raises a hand", "lowers it"),
        ("raises a hand", "lowers it again"),
        ("waves", "relaxes"),
        ("kicks", "repeats it"),
        ("lifts the left leg", "lets it sink"),
        ("lifts both arms like a champion", "lets them drop"),
        ("holds the arm out", "it is brought back"),
        ("the left foot is raised", "placed on the floor"),
        ("the head turns", "swings to the middle"),
        ("nods", "the head comes up again"),
        ("throws a punch", "pulls the fist back to his chin"),
        ("bows deeply", "stands tall"),
        ("leans to the side", "straightens"),
        ("turns the head", "looks straight ahead"),
        ("leans back", "rights himself"),
    ],
)
def test_the_end_of_an_action_is_no_other_one(first, second):
    assert only_ends(first, second)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("picks up a box with both hands", "puts it down"),
        ("picks the ball up with the left hand", "throws it"),
        ("waves", "drops to the floor"),
        ("raises the left hand", "lowers the right hand"),
        ("goes ahead on foot", "raises the hand and waves it"),
        ("lifts a leg", "kicks the bag with it"),
        ("raises both fists", "punches with them"),
        ("raises a hand", "takes a ball and throws it"),
        ("raises both arms", "walks back"),
        ("stands on the left foot", "puts the right foot down"),
        ("turns left", "jumps straight up"),
        ("raises a hand", "he walks on"),
    ],
)
def test_another_action_is_no_end(first, second):
    assert not only_ends(first, second)


@pytest.mark.parametrize(
    ("first", "second", "full"),
    [
        ("waves with the left hand", "with the right", ("waves with the left hand", "waves with the right hand")),
        (
            "waves with the left hand",
            "the same with the other one",
            ("waves with the left hand", "waves with the right hand"),
        ),
        ("after the left", "he lifts his right knee", ("he lifts his left knee", "he lifts his right knee")),
        ("kick left", "right", ("kick left", "kick right")),
        ("stomps with one foot", "the other", ("stomps with the left foot", "stomps with the right foot")),
        ("waving, first with the left", "with the right", ("waving with the left", "waving with the right")),
        ("waves with the left", "does so with the right", ("waves with the left", "waves with the right")),
        (
            "waves with the left hand",
            "repeats it with the right",
            ("waves with the left hand", "waves with the right hand"),
        ),
        ("raises the left hand", "the right foot", ("raises the left hand", "raises the right foot")),
        ("touches his left knee", "his left elbow", ("touches his left knee", "touches his left elbow")),
        ("raises the left arm", "both arms", ("raises the left arm", "raises both arms")),
        ("kicks with the left leg", "with both", ("kicks with the left leg", "kicks with both legs")),
        ("raises one hand", "both", ("raises one hand", "raises both hands")),
        (
            "walks to the left and raises the left hand",
            "the right",
            ("walks to the left and raises the left hand", "walks to the left and raises the right hand"),
        ),
        (
            "raises the right arm",
            "the left arm, then both arms",
            ("raises the right arm", "raises the left arm, then both arms"),
        ),
        ("kicks to the left", "the right leg", None),
        ("steps first left", "right, then left", None),
        ("waves with the left hand", "turns right", None),
        ("waves with both hands", "with the right", None),
        ("waves with the left hand", "with the left", None),
        ("left", "right", None),
        ("waves", "the other people", None),
    ],
)
def test_a_clause_of_a_side_alone_has_the_verb_of_the_other_one(first, second, full):
    assert fill_in(first, second) == full


def test_a_side_without_a_noun_has_that_of_the_other_clause():
    assert name_part("waves with the left", "raises the right hand") == "waves with the left hand"
    assert name_part("the left one is raised", "raises the right knee") == "the left knee is raised"
    for clause in ("turns to the left", "looks at the door on the left", "waves with the left arm"):
        assert name_part(clause, "raises the right hand") == clause
    assert name_part("waves with the left", "turns to the right side") == "waves with the left"


def sides(text):
    return set(re.findall("left|right", text.lower()))


def test_sentences_of_another_person_are_understood(known):
    whole = [caption for caption in SENTENCES["one_action"] if len(split_sequence(caption, known)) == 1]
    # Some have a third action behind an "and".
    cut = [caption for caption in SENTENCES["two_actions"] if len(split_sequence(caption, known)) >= 2]
    assert len(SENTENCES["one_action"]) == len(SENTENCES["two_actions"]) == 50
    assert len(whole) >= 45 and len(cut) >= 45
    found = [(split_sequence(one["text"], known), (one["first"], one["second"])) for one in SENTENCES["other_side"]]
    filled = [(parts, expected) for parts, expected in found if len(parts) == 2]
    assert len(filled) >= 34 and len(found) == 50
    for parts, expected in filled:
        assert list(map(sides, parts)) == list(map(sides, expected))
