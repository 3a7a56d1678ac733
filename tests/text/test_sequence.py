"""Sentences of several actions in turn, cut into one sentence for each."""

import re
from pathlib import Path

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from t2m_jax.checkpoints.bundle import bundle_path, load_training_data
from t2m_jax.text.coverage import make_knowledge
from t2m_jax.text.prompts import MAX_PROMPT_LENGTH
from t2m_jax.text.sequence import MAX_ACTIONS, split_sequence
from t2m_jax.text.verbs import word_set

SENTENCES = yaml.safe_load(Path(__file__).with_name("sequence.yaml").read_text())
WALK, WAVE = "a man walks", "he waves"


@pytest.fixture(scope="module")
def known():
    return make_knowledge(load_training_data(bundle_path("demo"))).actions


@pytest.mark.parametrize(
    "caption",
    [
        "a man walks, then he waves",
        "a man walks and then he waves.",
        "a man walks; afterwards, he waves",
        "a man walks. After that he waves.",
        "First a man walks, next he waves",
        "a man walks before he waves",
        "before he waves, a man walks",
        "a man walks -> he waves",
        "1. a man walks 2. he waves",
        "he waves. Before that, a man walks",
        "he waves, but a man walks first",
        "he waves after a man walks",
        "After a man walks, he waves",
        "as soon as a man walks he waves",
        "he waves, but not before a man walks",
        "a man walks until he waves",
        "a man walks, and finally he waves",
        "a man walks and he waves afterwards",
        "a man walks, and he waves after that.",
    ],
)
def test_two_actions_come_in_the_order_in_which_they_happen(caption, known):
    assert split_sequence(caption, known) == (WALK, WAVE)


def test_three_actions_are_three_sentences(known):
    found = split_sequence("before he bows, a man walks, then he waves", known)
    assert found == (WALK, WAVE, "he bows")
    assert split_sequence("walks to the door, stops and then waves", known) == (
        "walks to the door",
        "stops",
        "waves",
    )
    corner = "walks on, then turns left"
    assert split_sequence(f"{corner}, then waves to the left", known) == (corner, "waves to the left")
    assert split_sequence(f"{corner}, then walks to the door", known) == (corner, "walks to the door")
    assert split_sequence("waves and, after that, bows", known) == ("waves", "bows")
    seat = "gets out of the old armchair"
    assert split_sequence(f"{seat} and walks on", known) == (seat, "walks on")
    assert split_sequence("a nurse rises from her chair and waves", known) == ("a nurse rises from her chair", "waves")


def test_an_action_may_be_named_by_a_noun(known):
    assert split_sequence("he bows before a high kick", known) == ("he bows", "a high kick")
    assert split_sequence("he waves when he has walked", known) == ("he has walked", "he waves")


def test_one_step_after_the_other_is_one_action(known):
    for caption in ("she walks on, step after step", "walks backward, time after time"):
        assert split_sequence(caption, known) == (caption,)


@pytest.mark.parametrize(
    "parts",
    [
        ("runs", "turns left and walks"),
        ("walks", "turns around"),
        ("walks", "turns 180 degrees to the left and walks on"),
        ("walks and turns left", "walks and turns right"),
        ("steps to the left", "steps to the right"),
        ("moves forward", "the left hand goes up"),
    ],
)
def test_what_is_no_corner_is_an_action(parts, known):
    assert split_sequence(f"{parts[0]}, then {parts[1]}", known) == parts


@pytest.mark.parametrize(
    "caption",
    [
        WALK,
        "runs after the bus",
        "stands before the door",
        "a man walks until the evening",
        "now and then he jumps",
        "he never walks before he waves",
        "walks slowly, dragging his left foot",
        "a man walks while he waves",
        "a man walks. Meanwhile, he waves",
        "a man walks; at the same time he waves",
        "raises the right hand and then lowers it",
        "stands up after 8 seconds",
        "lift both arms, and make it look old",
        "walks slowly, then turns left",
        "turns right, then walks on",
        "walks, then turns left and walks on",
        "raises a hand, then puts it down",
        "he waves before the window",
        "he jumps upon the box",
        "he runs after a jumping dog",
        "she dances before a clapping audience",
        "he waves when he is walking",
    ],
)
def test_one_action_is_not_cut(caption, known):
    assert split_sequence(caption, known) == (caption,)


def test_a_model_without_a_record_of_its_actions_reads_whole_sentences():
    assert split_sequence(f"{WALK}, then {WAVE}", ()) == (f"{WALK}, then {WAVE}",)


def plain(part):
    return " ".join(re.sub(r"[,.;!]", "", part.lower()).split())


def is_same(part, expected):
    return plain(expected) in plain(part) or plain(part) in plain(expected)


@pytest.mark.parametrize(
    ("caption", "parts"),
    [
        ("a man stands up and walks off", ("a man stands up", "walks off")),
        ("walks, then turns around and walks back", ("walks", "turns around", "walks back")),
        ("he walks to the net and waves", ("he walks to the net", "waves")),
        ("a boy enters the room, and he claps", ("a boy enters the room", "claps")),
        ("she turns around and waves", ("she turns around", "waves")),
        ("she goes to the lamp and switches it off", ("she goes to the lamp", "switches it off")),
        ("he waves and leaves the room", ("he waves", "leaves the room")),
        ("walk over, turn around and sit down", ("walk over", "turn around", "sit down")),
        ("she gets to her feet, and she waves", ("she gets to her feet", "waves")),
        ("he jumps and sits down", ("he jumps", "sits down")),
        ("she turns left and bows", ("she turns left on the spot", "bows")),
        ("claps, then turns to the right, then waves", ("claps", "turns to the right on the spot", "waves")),
        ("walks and waves and bows", ("walks and waves", "bows")),
        ("a person walks.A person waves.", ("a person walks", "A person waves")),
        ("walk...then wave", ("walk", "wave")),
    ],
)
def test_two_postures_are_in_turn(known, caption, parts):
    assert split_sequence(caption, known) == parts


@pytest.mark.parametrize(
    "caption",
    [
        "walks and waves",
        "sits down and waves",
        "bends down and stands up",
        "he jumps and turns",
        "walk e.g.a lot",
        "runs past the door and window",
        "he walks past the benches and houses",
        "she walks through the cool and clean hall",
        "walks down the hall and turns left",
        "strolls along the lake and waves all the way",
        "walks through the gate and walks on",
        "he ran to the gate and went on",
        "he runs to the door and back",
    ],
)
def test_other_actions_around_an_and_are_at_once(known, caption):
    assert split_sequence(caption, known) == (caption,)


def test_sentences_of_other_people_are_cut_as_they_say(known):
    found = [(split_sequence(one["text"], known), one["parts"]) for one in SENTENCES["sequences"]]
    right = [len(cut) == len(parts) and all(map(is_same, cut, parts)) for cut, parts in found]
    reversed_order = [
        len(cut) == len(parts) == 2 and is_same(cut[0], parts[1]) and not is_same(*cut) for cut, parts in found
    ]
    assert sum(right) >= 57 and len(right) == 84
    assert sum(reversed_order) <= 1
    cut = [caption for caption in SENTENCES["whole"] if len(split_sequence(caption, known)) > 1]
    assert len(cut) <= 4 and len(SENTENCES["whole"]) == 56


@pytest.mark.parametrize("words", ["walk then ", "walk, ", "before he walks ", "walk until walking ", "and "])
def test_long_sentences_are_left_whole(words, known):
    caption = (words * MAX_PROMPT_LENGTH)[:MAX_PROMPT_LENGTH].strip()
    assert 1 <= len(split_sequence(caption, known)) <= MAX_ACTIONS


WORDS = sorted(
    word_set(
        """then before after until having the left right hand arm it them other one and , . ; ! walks waves turns lowers
        back again same do so with his is first but next finally followed by 180 - '"""
    )
)


@example("walks before ,")
@given(st.lists(st.sampled_from(WORDS), min_size=1, max_size=12).map(" ".join))
def test_any_words_are_read(known, caption):
    parts = split_sequence(caption, known)
    assert parts == (caption,) or all(part.strip() for part in parts)


@pytest.mark.parametrize(
    ("caption", "parts"),
    [
        ("a man walks and, after waving, jumps", ("a man walks", "waving", "jumps")),
        ("a man walks and, before sitting down, waves", ("a man walks", "waves", "sitting down")),
        ("a man walks, and once he has waved, he jumps", ("a man walks", "he has waved", "he jumps")),
        ("a man walks and waves at the same time, then jumps", ("a man walks and waves at the same time", "jumps")),
    ],
)
def test_what_comes_between_is_done_between(caption, parts, known):
    assert split_sequence(caption, known) == parts
