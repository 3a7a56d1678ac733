"""Shapes of the path over the ground that a sentence asks for, such as "in a circle"."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from t2m_jax.text.verbs import CLAUSE_STARTS, PREPOSITIONS, SIDES, Word, readings, word_set, words_of

TRAVELS = word_set(
    """circle crawl creep curve dance dash fly gallop glide go hike hop hurry jog limp loop march pace parade
    prance prowl run rush saunter scurry shuffle sidestep skate skip slither sneak sprint stagger step stride stroll
    strut stumble swim tiptoe travel trot trudge waddle walk wander weave zigzag"""
)
"""Verbs of somebody who moves over the ground, in their basic forms."""
LEADERS = word_set("in into around round along through follow follows following")
"""Words before a shape, beside verbs."""
MAKES = word_set("complete do form make take trace")
NO_SHAPE_AFTER = word_set("the this that his her their my its")
""""The square" is a place."""
TURNS = {"circle": 360, "loop": 360, "ring": 360, "circular": 360, "semicircle": 180, "quarter-circle": 90}
"""Degrees of a shape in which the path bends evenly."""
SHAPES = word_set(
    "arc circle curve ellipse loop oval quarter-circle rectangle ring s-curve semicircle spiral square triangle"
)
BY_THEMSELVES = word_set("figure-eight serpentine slalom zigzag")
"""Shapes that need no word before them."""
BENDS = word_set("arc curve curved quarter-circle")
"""Shapes that "to the left" says, too, which is a turn that captions have."""
ADJECTIVES = word_set("circular curved curvy diamond oval rectangular square triangular wavy winding")
PATHS = word_set("fashion line loop manner motion path pattern route shape track trajectory way")
"""Nouns after an adjective."""
_SAME = (
    (r"\bround and a?round\b|\baround and a?round\b", "in circles"),
    (r"\b(?:half|semi)[ -]?circle", "semicircle"),
    (r"\bquarter[ -]circle", "quarter-circle"),
    (r"\bfigure(?:[ -]of)?[ -](?:eight|8)", "figure-eight"),
    (r"\bzig[ -]zag", "zigzag"),
    (r"\bs[ -](?:shape|curve)", "s-curve"),
)
"""Other spellings of a shape, and the one that is looked for."""
_ON_THE_SPOT = re.compile(r"\b(?:in (?:one |the same )?place|on (?:the|one|the same) spot|on (?:a|the) treadmill)\b")
_STAYS = word_set("circle curve hop loop skip weave")
"""Of the verbs of `TRAVELS`, those that may be done in one place."""
_TO_THE_RIGHT = re.compile(r"(?<!counter[ -])(?<!anti[ -])\b(?:clockwise|right)\b")


class PathShape(NamedTuple):
    """The shape of a path."""

    name: str
    option: str
    """What gives a motion this path, for a warning."""


def find_path_shape(caption: str) -> PathShape | None:
    """Returns the shape of the path that a caption asks for, or its being in place; None if it asks for none."""
    text = caption.lower()
    for pattern, name in _SAME:
        text = re.sub(pattern, name, text)
    words = words_of(text)
    spot = _ON_THE_SPOT.search(text)
    verbs = [word for word in words_of(text[: spot.start()]) if word.action] if spot else []
    if spot and verbs and _is_travel(verbs[-1]) and verbs[-1].bases.isdisjoint(_STAYS):
        return PathShape(spot[0], "the option `in_place` removes the travel")
    for place in range(len(words)):
        name = _shape_at(words, place)
        is_turn = name in BENDS and any(word.text in SIDES for word in words)
        if name and not is_turn and _moves_so(words, place):
            sign = "-" if _TO_THE_RIGHT.search(text) else ""
            by = f"`turn` bends it, here by {sign}{TURNS[name]}" if name in TURNS else "`path` leads it through points"
            return PathShape(name, f"the option {by}")
    return None


def _shape_at(words: Sequence[Word], place: int) -> str:
    """Returns the shape that a word says, in its basic form, or an empty text."""
    word = words[place]
    after = words[place + 1].text if place + 1 < len(words) else ""
    if word.text in ADJECTIVES and after in PATHS:
        return word.text if _is_led(words, place) else ""
    # "A spiral notebook", "a circle of friends".
    if after == "of" or (readings(after).keys() == {"NOUN"} and after not in PATHS):
        return ""
    if found := word.bases & BY_THEMSELVES:
        return min(found)
    noun = word.text if word.text in SHAPES else word.text.removesuffix("s")
    return noun if noun in SHAPES and _is_led(words, place) else ""


def _is_led(words: Sequence[Word], place: int) -> bool:
    """Returns whether what is before a shape says that it is one: "in a big ...", "runs a ..."."""
    for word in reversed(words[max(place - 5, 0) : place]):
        if word.text in LEADERS or _is_travel(word) or not MAKES.isdisjoint(word.bases):
            return True
        if word.text in NO_SHAPE_AFTER | PREPOSITIONS | CLAUSE_STARTS:
            return False
    return False


def _moves_so(words: Sequence[Word], place: int) -> bool:
    """Returns whether the person moves in a shape, and not a hand or a ball: the last verb before it tells."""
    if words[place].action in BY_THEMSELVES:
        return True
    before = [word for word in words[:place] if _is_travel(word) or (word.action and word.bases.isdisjoint(MAKES))]
    return any(map(_is_travel, before[-1:] or words[place + 1 :]))


def _is_travel(word: Word) -> bool:
    return not TRAVELS.isdisjoint(word.bases)
