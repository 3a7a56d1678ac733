"""The words of captions, and which of them are actions."""

import pytest

from t2m_jax.text.verbs import readings, words_of


@pytest.mark.parametrize(
    ("caption", "actions"),
    [
        ("A person walks forward.", ["walk"]),
        ("a person jumps", ["jump"]),
        ("Subject waves with right hand", ["wave"]),
        ("someone swam, then sat down", ["swim", "sit"]),
        ("he is pushed to the left and recovers", ["push", "recover"]),
        ("sneaking while crouched", ["sneak", "crouch"]),
        ("Walk! Then run.", ["walk", "run"]),
        ("she starts to jog", ["start", "jog"]),
        ("they dance", ["dance"]),
        ("turn right while you’re walking", ["turn", "walk"]),
        # nouns that could be verbs
        ("my grandmother is walking in the park", ["walk"]),
        ("a man walks to school", ["walk"]),
        ("a person lifts weights", ["lift"]),
        ("a person lifts arms and legs", ["lift"]),
        ("a person walks four steps", ["walk"]),
        ("a drunk man walks", ["walk"]),
        ("drunk man walks", ["walk"]),
        ("a tired woman walks a little bit", ["walk"]),
        ("the person turns left", ["turn"]),
        # objects of verbs that say nothing themselves
        ("a person makes a low kick", ["make", "kick"]),
        ("a human performs a wiping motion", ["perform", "wipe"]),
        ("a person performs the Egyptian move", ["perform"]),
        ("a person takes a few steps forward", ["take", "step"]),
        ("", []),
        ("...", []),
    ],
)
def test_the_actions_of_a_caption(caption, actions):
    assert [word.action for word in words_of(caption) if word.action] == actions


@pytest.mark.parametrize(
    ("caption", "words"),
    [
        ("she can't walk", "she can not walk"),
        ("he won’t stop", "he will not stop"),
        ("it doesn't, I'd say", "it does not i say"),
    ],
)
def test_short_forms_keep_their_negation(caption, words):
    assert [word.text for word in words_of(caption)] == words.split()


def test_words_have_their_basic_forms():
    words = {word.text: word.bases for word in words_of("A woman’s feet moved 3,5 m anti-clockwise, 90 degrees")}
    assert list(words) == ["a", "woman", "feet", "moved", "3,5", "m", "anti-clockwise", "90", "degrees"]
    assert words["feet"] == {"feet", "foot"} and words["moved"] >= {"moved", "move"} and words["90"] == {"90"}


def test_other_languages_have_words_without_readings():
    assert [word.text for word in words_of("人が歩く; der Mädchen läuft")] == ["人が歩く", "der", "mädchen", "läuft"]
    assert readings("läuft") == {} and readings("left") == {}
