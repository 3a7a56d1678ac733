import random

import pytest

from t2m_jax.data.captioning.lexicon import known_words, words_in
from t2m_jax.data.captioning.typing_habits import TYPO_SHARE, as_typed, misspell, neighbors, with_typo

SENTENCE = "a person walks forward and waves with the left hand"


def test_as_many_sentences_as_said_have_one_mistake():
    generator = random.Random(0)
    typed = [words_in(as_typed(SENTENCE, generator)) for _ in range(4000)]
    changed = [words for words in typed if words != words_in(SENTENCE)]
    assert abs(len(changed) / len(typed) - TYPO_SHARE) < 0.015
    for words in changed:
        assert sum(one != other for one, other in zip(words, words_in(SENTENCE), strict=True)) == 1


def test_a_mistake_gives_no_known_word_and_no_other_side():
    generator = random.Random(1)
    for _ in range(3000):
        words = words_in(with_typo(SENTENCE, generator))
        new = [word for word, right in zip(words, words_in(SENTENCE), strict=True) if word != right]
        assert len(new) == 1 and new[0] not in known_words() and "left" in words and "right" not in words


def test_sentences_of_short_words_have_no_mistake():
    assert with_typo("she sat, as I did", random.Random(2)) == "she sat, as I did"


def test_mistakes_are_of_four_kinds():
    found = {misspell("abcd", random.Random(number)) for number in range(300)}
    assert found == {"acbd", "abdc", "acd", "abd", "abbcd", "abccd"} | {
        before + key + after
        for before, letter, after in (("a", "b", "cd"), ("ab", "c", "d"))
        for key in neighbors()[letter]
    }


@pytest.mark.parametrize(("letter", "expected"), [("s", "adwx"), ("q", "wa"), ("m", "nj")])
def test_neighboring_keys(letter, expected):
    assert set(neighbors()[letter]) == set(expected)


def test_capitals_and_marks_vary_but_not_after_a_question():
    generator = random.Random(3)
    typed = {as_typed("can you run?", generator) for _ in range(500)}
    assert {"can you run?", "Can you run?", "CAN YOU RUN?"} <= typed and all("?." not in text for text in typed)
    assert {text[-1] for text in (as_typed("run", generator) for _ in range(500))} >= {"n", ".", "!"}
