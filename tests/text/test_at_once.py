"""Sentences that ask legs and arms for something at the same time."""

import pytest

from t2m_jax.text.at_once import LONGEST, SaidAtOnce, in_plain_words, said_at_once

LEFT = frozenset({"left"})
RIGHT = frozenset({"right"})
BOTH = LEFT | RIGHT
NONE = frozenset()


@pytest.mark.parametrize(
    ("sentence", "said"),
    [
        ("a scout marches ahead and waves with the right hand", SaidAtOnce("walk", "wave", RIGHT)),
        ("Strolling along, she waves at the crew", SaidAtOnce("walk", "wave", NONE)),
        ("his left arm waving, the fan sprints past the stand", SaidAtOnce("run", "wave", LEFT)),
        ("with both hands over his head he jogs to the truck", SaidAtOnce("run", "raise", BOTH)),
        ("running after the bus, the child waves with the left hand", SaidAtOnce("run", "wave", LEFT)),
        ("holding up the right hand he walks on", SaidAtOnce("walk", "raise", RIGHT)),
        ("runs on with hands in the air", SaidAtOnce("run", "raise", BOTH)),
        ("moves forward, arms raised", SaidAtOnce("walk", "raise", BOTH)),
        ("lifts the left and right hand while walking", SaidAtOnce("walk", "raise", BOTH)),
        ("applauds during a slow walk", SaidAtOnce("walk", "clap", NONE)),
        ("throwing punches as he runs", SaidAtOnce("run", "punch", NONE)),
        ("steps back with her hands up", SaidAtOnce("backward", "raise", BOTH)),
        ("claps while walking in reverse", SaidAtOnce("backward", "clap", NONE)),
        ("waves the right hand as she walks around the left corner", SaidAtOnce("left", "wave", RIGHT)),
        ("turns right while walking with the left arm up", SaidAtOnce("right", "raise", LEFT)),
        # Hands that do something else.
        ("he walks with the left hand in his pocket while waving the right hand", SaidAtOnce("walk", "wave", RIGHT)),
        ("he walks with his left hand on his hip and waves his right hand", SaidAtOnce("walk", "wave", RIGHT)),
        ("she jogs with a cane in the right hand and waves with her left", SaidAtOnce("run", "wave", LEFT)),
        ("holding a lamp in the left hand, she walks and raises the other", SaidAtOnce("walk", "raise", RIGHT)),
        ("run with both hands raised", SaidAtOnce("run", "raise", BOTH)),
        # Other paths are not checked.
        ("waves both hands while walking in a circle", SaidAtOnce("", "wave", BOTH)),
        ("walks to the left clapping", SaidAtOnce("", "clap", NONE)),
        ("claps as she walks upstairs", SaidAtOnce("", "clap", NONE)),
    ],
)
def test_legs_and_arms_are_read(sentence, said):
    assert said_at_once(sentence) == said


@pytest.mark.parametrize(
    "sentence",
    [
        "a person walks forward",
        "a person waves with the left hand",
        "the left hand goes up above the head",
        "a man moves the raised hand from side to side",
        "a stranded sailor waves both arms over his head to a ship",
        "run up and make one long jump",
        "he walks on without waving",
        "she never claps while she walks",
        "walks while the others clap",
        "she walks through the waves",
        "picks up the phone and walks on",
        "walks up the hill with both hands in the pockets",
        "with her hands on her hips she walks up to the counter",
        "walks with hands in pockets up the street",
        "carries a box in both hands down the hall",
        "she raises a hand and stands still",
        "walks to the fence, then waves",
        "after a wave with both hands the singer walks off",
        "puts the right arm up, lowers it and walks ahead",
        "before she waves with the left hand she runs to the gate",
        "he walks to the door and raises his hand",
        # What others do, and things.
        "a person walks to a friend who is waving",
        "she walks toward the person waving at her",
        "he runs to the man who claps",
        "he walks past a clapping audience",
        "a person walks past a punching bag",
        "a man walks into the waves with his hands in his pockets",
        "he marches lifting the knees high with the hands on the hips",
        "he walks to the raised platform with a bag in his hand",
    ],
)
def test_other_sentences_ask_for_nothing_at_once(sentence):
    assert said_at_once(sentence) is None


def test_long_sentences_are_not_read():
    caption = "waves while walking to the shop " + "at the corner " * 13
    assert said_at_once(caption[:LONGEST]) is not None and said_at_once(caption) is None


def test_plain_words_say_the_same():
    for legs in ("walk", "run", "backward", "left", "right"):
        for arms, hands in (("clap", NONE), ("punch", NONE), *(("wave", own) for own in (NONE, LEFT, RIGHT, BOTH))):
            said = SaidAtOnce(legs, arms, hands)
            assert said_at_once(in_plain_words(said)) == said
    assert in_plain_words(SaidAtOnce("run", "raise", LEFT)) == "a person runs forward while raising the left hand"
    assert in_plain_words(SaidAtOnce("", "wave", LEFT)) == ""
