"""How people type: capitals, final marks and typing mistakes."""

import functools
import random
import re
import string

from t2m_jax.data.captioning.lexicon import known_words

TYPO_SHARE = 0.08
"""Share of the captions with one typing mistake."""
SHORTEST_TYPO = 4
"""Letters of the shortest word that gets one."""
SIDES = re.compile("left|right|clock", re.IGNORECASE)
"""Words without mistakes: mirroring a caption would not find them, and so would leave the wrong side."""
CAPITALS = {"lower": 48, "first": 50, "all": 2}
MARKS = {"": 55, ".": 42, "!": 2, " .": 1}
KEYBOARD = ("qwertyuiop", "asdfghjkl", "zxcvbnm")


@functools.cache
def neighbors() -> dict[str, str]:
    """Returns letter -> letters of the keys beside, above and below it."""
    keys = {letter: (line, place) for line, letters in enumerate(KEYBOARD) for place, letter in enumerate(letters)}
    return {
        letter: "".join(other for other, (x, y) in keys.items() if abs(x - line) + abs(y - place) == 1)
        for letter, (line, place) in keys.items()
    }


def misspell(word: str, generator: random.Random) -> str:
    """Returns a word with one mistake: two letters exchanged, one missing, doubled, or from the neighboring key."""
    place = generator.randrange(1, len(word) - 1)
    before, letter, after = word[:place], word[place], word[place + 1 :]
    wrong = {
        "exchanged": before + after[0] + letter + after[1:],
        "missing": before + after,
        "doubled": before + letter * 2 + after,
        "neighboring": before + generator.choice(neighbors().get(letter, letter)) + after,
    }
    return wrong[generator.choice(tuple(wrong))]


def with_typo(text: str, generator: random.Random) -> str:
    """Returns a sentence with a mistake in one word that gives no known word; unchanged if all are short."""
    words = [match for match in re.finditer(rf"\b[a-z]{{{SHORTEST_TYPO},}}\b", text) if not SIDES.search(match.group())]
    if not words:
        return text
    word = generator.choice(words)
    wrong = misspell(word.group(), generator)
    # Never "walk" for "wall", and no mistake that is none, as two equal letters exchanged.
    while wrong == word.group() or wrong in known_words() or SIDES.search(wrong):
        wrong = misspell(word.group(), generator)
    return text[: word.start()] + wrong + text[word.end() :]


def as_typed(text: str, generator: random.Random) -> str:
    """Returns a sentence as people type it."""
    if generator.random() < TYPO_SHARE:
        text = with_typo(text, generator)
    if text[-1] not in string.punctuation:
        text += generator.choices(tuple(MARKS), tuple(MARKS.values()))[0]
    (capitals,) = generator.choices(tuple(CAPITALS), tuple(CAPITALS.values()))
    if capitals == "first":
        return text[0].upper() + text[1:]
    return text.lower() if capitals == "lower" else text.upper()
