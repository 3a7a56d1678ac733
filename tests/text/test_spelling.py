"""Typing mistakes: what is corrected, and what never is."""

import pytest

from t2m_jax.text.spelling import correct_spelling
from t2m_jax.text.verbs import readings, word_set

KNOWN = word_set("a person walks walk with the left hand right jumps turns around running both arms now four")


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("wlaks", "walks"),
        ("walkss", "walks"),
        ("wals", "walks"),
        ("wslks", "walks"),
        ("runing", "running"),
        ("jmups", "jumps"),
        ("rigth", "right"),
        ("wiht", "with"),
    ],
)
def test_one_mistake_is_corrected(typed, meant):
    prompt, read = correct_spelling(f"a person {typed} now", KNOWN)
    assert (prompt, read) == (f"a person {meant} now", {typed: meant})


@pytest.mark.parametrize(
    "prompt",
    [
        "a person walks with the left hand",
        "a person talks to a walker",  # other English words
        "hops on the lift",
        "a person on all fours",  # of a known word
        "then Walsk arrives, and Jmups",  # names
        "he hse a hnd",  # too short
        "a person xyzzyx quuxly",
        "the person is among those within",  # words of grammar that no caption has
        "walks 90 degrees, 3x, and doesn't jumb-o",
        "une personne marche lentement",
        "een man springt, wlaks",  # one word of another language is enough
        "wanna walk",
    ],
)
def test_nothing_else_is_changed(prompt):
    assert correct_spelling(prompt, KNOWN) == (prompt, {})


def test_the_first_word_may_be_a_mistake_with_a_capital_letter():
    assert correct_spelling("Wlaks around", KNOWN) == ("walks around", {"Wlaks": "walks"})


def test_exchanged_letters_are_likelier_than_a_missing_one():
    assert correct_spelling("raht", frozenset({"rath", "raght"}))[1] == {"raht": "rath"}


def test_a_rare_word_is_no_mistake_and_no_mistake_is_read_as_one():
    rare = frozenset({"walkers"})
    assert correct_spelling("a person walkes", KNOWN | rare)[1] == {"walkes": "walkers"}
    assert correct_spelling("a person walkes by walkers", KNOWN | rare, rare=rare)[1] == {"walkes": "walks"}


def test_many_words_that_are_none_are_not_corrected_and_cost_little():
    prompt = " ".join(f"wlaks{letter}" for letter in "abcd")
    before = readings.cache_info().currsize
    assert correct_spelling(f"{prompt} wlaks", KNOWN) == (f"{prompt} wlaks", {})
    assert readings.cache_info().currsize <= before + 5
