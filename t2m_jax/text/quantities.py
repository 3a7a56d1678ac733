"""How long a sentence says that its motion lasts ("for five seconds"), and how often something is done ("twice")."""

import itertools
import re
from collections.abc import Collection, Sequence
from typing import NamedTuple

from t2m_jax.text.verbs import (
    CLAUSE_STARTS,
    DETERMINERS,
    PERFORMING_VERBS,
    PREPOSITIONS,
    SIDES,
    Word,
    forms,
    word_set,
    words_of,
)

LONGEST = 600.0
"""Longest motion in seconds that a sentence can ask for; more is hardly meant."""
MOST_TIMES = 20
"""Most times that a sentence can ask for; more are no motion of some seconds."""

_ONES = ("one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
_TEENS = """ten eleven twelve thirteen fourteen fifteen sixteen seventeen eighteen nineteen"""
_TENS = ("twenty", "thirty", "forty", "fifty", "sixty", "seventy", "eighty", "ninety")
_TO_HUNDRED = [*_ONES, *_TEENS.split(), *(f"{tens} {one}".strip() for tens in _TENS for one in ("", *_ONES))]
_VALUES = {word: float(number) for number, word in enumerate(_TO_HUNDRED, 1)} | {
    "a hundred": 100.0,
    "one hundred": 100.0,
    "a couple of": 2.0,
    "a couple": 2.0,
    "half a dozen": 6.0,
    "a dozen": 12.0,
    "half an": 0.5,
    "half a": 0.5,
    "a quarter of a": 0.25,
    "once": 1.0,
    "twice": 2.0,
    "thrice": 3.0,
    "a single": 1.0,
    "a double": 2.0,
    "a triple": 3.0,
}
_ADVERBS = ("once", "twice", "thrice")
_SINGULAR = ("one", "1", "a single", "a double", "a triple")
"""Numbers before a noun that is not a plural."""
# The longest first, so that "half a dozen" is not "half a".
_WORDS = [word.replace(" ", "[ -]") for word in sorted(_VALUES.keys() - set(_ADVERBS), key=len, reverse=True)]
# "1,200" is a thousand, and "1,2" is not.
_NUMBER = "|".join([r"\d{1,6}(?:\.\d{1,6}|,(?!\d{3}\b)\d{1,6})?", *_WORDS])
# Not the end of a larger number.
_START = r"(?<![\w.,/-])(?<!hundred )(?<!hundred and )(?<!thousand )"


def _pattern(*parts: str) -> re.Pattern[str]:
    return re.compile("".join(parts), re.IGNORECASE)


_TIME = _pattern(
    rf"{_START}(?:(?P<number>{_NUMBER})|(?:(?<=for )|^)(?P<a>a)(?: full| whole)?)(?P<half> and a half)?",
    r"(?:[ -]?(?P<unit>seconds?|secs?|minutes?|mins?)|(?<=\d) ?s)\b(?P<later> and a half)?",
)
_NO_LENGTH_AFTER = _pattern(
    r"(?<!stop )(?<!stops )(?<!ends )(?<!stopped )(?<!stopping )",
    r"\b(?:after|another|at|before|by|count(?:s|ed|ing)? to|each|every|first|from|last|next|once|only|per|since|than|",
    r"till|until|within)(?: (?:the|a|an|about|around|roughly|first|last|next|only|exactly))* $",
)
"""What stands before a time that is no length: "after three seconds", but not "stops after three seconds"."""
_NO_LENGTH_BEFORE = _pattern(
    r"[ -]+(?:long )?(?:after|ago|apart|before|break|delay|each|gap|in(?:to)?\b(?! \w)|in,|interval|late|mark|pause|",
    r"rest|time ?out|too)",
)
_DECADE_AFTER = _pattern(r"\b(?:his|her|their|my|your|the|early|mid|late)[ -]$")
_DECADE_BEFORE = _pattern(
    r" (?:clothes|dances?|disco|fashion|hip|looks?|movies?|music|outfits?|rock|shows?|style|television|tv)\b"
)
"""What stands around "70s" if it is a decade or an age."""
_PAUSES = word_set("freeze hesitate hold pause rest wait")
_TIMES = _pattern(
    rf"{_START}(?:(?P<number>{_NUMBER}) (?:times?|reps?|repetitions?)|(?P<adverb>{'|'.join(_ADVERBS)})|",
    "(?P<before>\\d{1,6}) ?[x\u00d7]|[x\u00d7](?P<after>\\d{1,6}))(?![\\w-])",
)
_NO_TIMES_AFTER = _pattern(r"\b(?:at|all at|every|for|more than|thinks?|thought|was|were) $")
_NO_TIMES_BEFORE = _pattern(
    r" (?:as|a|an|per|the|more|again|faster|slower|longer|bigger|higher|larger|every|",
    r"he|she|it|they|you|his|her|somebody|someone)\b",
)
"""What stands behind words that do not say how often: "once he sits", "twice as fast"."""
_NOUN = _pattern(
    r"(?<!the )(?<!is )(?<!are )(?<!was )(?<!stands )(?<!standing )",
    rf"{_START}(?P<number>{_NUMBER})(?: (?:rep|repetition|round)s? of)?(?P<words>(?: [\w-]+){{1,3}})",
)
"""A number and the words after it: "takes three big steps". "Sweeps the eight steps" and "is three steps away" say no
number of times."""
_BENDS = word_set("arc bend circle corner curve loop rotate spin swerve turn veer zigzag")
"""Words for a path that is not straight."""
_NO_NOUN = PREPOSITIONS | CLAUSE_STARTS
_DEFINITE = DETERMINERS - word_set("a an another any no one two three four five six seven eight nine ten")
"""Words before things that are there: "the box"."""
_WITH_ACTION = PERFORMING_VERBS | {"throw"}
"""Verbs whose object is done, not hit: "throws a punch"."""


class Times(NamedTuple):
    """How often something is done."""

    action: str
    """Basic form of its verb, such as `wave`."""
    sides: frozenset[str]
    """`left`, `right`, or both."""
    number: int


def said_seconds(caption: str) -> float | None:
    """Returns how many seconds a sentence says that its whole motion lasts; None if it does not say so.

    "After three seconds", "every second" and "waits a second before waving" say no length.
    """
    time = _find_time(caption)
    if time is None:
        return None
    number = 1.0 if time["a"] else _value(time["number"])
    if time["half"] or time["later"]:
        number += 0.5
    seconds = 60 * number if (time["unit"] or "s").lower().startswith("m") else number
    return seconds if 0 < seconds <= LONGEST else None


def said_times(caption: str, countable: Collection[str]) -> Times | None:
    """Returns how often a sentence says that an action is done; None if it does not say so.

    Args:
        caption: A checked sentence.
        countable: Basic forms of the verbs that can be counted.
    """
    count, action = _counted_verb(caption, countable) or _counted_noun(caption, countable) or (0.0, "")
    words = words_of(caption)
    # "Four steps in a curve": the motion has to go on until the curve is done.
    is_path = action == "step" and any(not _BENDS.isdisjoint(word.bases) for word in words)
    if not count.is_integer() or not 1 <= count <= MOST_TIMES or is_path:
        return None
    sides = SIDES & {word.text for word in words}
    return Times(action, sides if len(sides) == 1 else SIDES, int(count))


def quantity_words(caption: str, countable: Collection[str] = ()) -> frozenset[str]:
    """Returns the words of a sentence that say how long or how often, in lower case.

    `countable` are the basic forms of the verbs that can be counted, as in "four steps".
    """
    times = _find_times(caption)
    found = [_find_time(caption), times]
    words = {word.text for part in found if part is not None for word in words_of(part[0])}
    noun = None if times or said_times(caption, countable) is None else _find_counted_noun(caption, countable)
    return frozenset(words if noun is None else words | {word.text for word in words_of(noun[0]["number"])})


def _find_time(caption: str) -> re.Match[str] | None:
    """Returns where a sentence says the length of its motion. Of two times, neither can be it."""
    found = [time for time in _TIME.finditer(caption) if not _is_decade(time, caption)]
    if len(found) != 1 or _is_pause(caption):
        return None
    (time,) = found
    is_other = _NO_LENGTH_AFTER.search(caption[: time.start()]) or _NO_LENGTH_BEFORE.match(caption[time.end() :])
    return None if is_other else time


def _is_decade(time: re.Match[str], caption: str) -> bool:
    """Returns whether "70s" is no time but a decade or an age."""
    before = caption[: time.start()]
    if time["unit"] or before.lower().endswith("for ") or _value(time["number"]) % 10:
        return False
    return bool(_DECADE_AFTER.search(before) or _DECADE_BEFORE.match(caption[time.end() :]))


def _is_pause(caption: str) -> bool:
    """Returns whether a time may be that of a pause, and not that of all that is done."""
    actions = {word.action for word in words_of(caption) if word.action}
    return len(actions) > 1 and not actions.isdisjoint(_PAUSES)


def _find_times(caption: str) -> re.Match[str] | None:
    """Returns where a sentence says "three times" or the like."""
    for times in _TIMES.finditer(caption):
        before = caption[: times.start()]
        if before and not _NO_TIMES_AFTER.search(before) and not _NO_TIMES_BEFORE.match(caption[times.end() :]):
            return times
    return None


def _value(number: str) -> float:
    """Returns the value of a number in digits or words."""
    number = number.lower().replace("-", " ")
    return _VALUES[number] if number in _VALUES else float(number.replace(",", "."))


def _counted_verb(caption: str, countable: Collection[str]) -> tuple[float, str] | None:
    """Returns how often, and the action: the last one before it, or else the last of all."""
    times = _find_times(caption)
    if times is None:
        return None
    number = times["number"] or times["adverb"] or times["before"] or times["after"]
    for text in (caption[: times.start()], caption):
        words = words_of(text)
        bases = [{word.action} & set(countable) or word.bases & set(countable) for word in words]
        actions = [index for index, found in enumerate(bases) if found and not _is_thing(words, index, countable)]
        # Some actions are only seen as nouns.
        if chosen := actions or [index for index, found in enumerate(bases) if found]:
            return _value(number), min(bases[chosen[-1]])
    return None


def _is_thing(words: Sequence[Word], index: int, countable: Collection[str]) -> bool:
    """Returns whether a noun is not what is done: "kicks the box", "jumps off the step", but not "throws a punch"."""
    if words[index].action:
        return False
    for word in words[:index][::-1]:
        if word.text in _DEFINITE:
            return True
        if word.action or word.text in _NO_NOUN:
            return word.action in countable and word.action not in _WITH_ACTION
    return False


def _counted_noun(caption: str, countable: Collection[str]) -> tuple[float, str] | None:
    """Returns the number before the noun of an action, and the action: "two punches", but not "one hand waves"."""
    found = _find_counted_noun(caption, countable)
    return None if found is None else (_value(found[0]["number"]), found[1])


def _find_counted_noun(caption: str, countable: Collection[str]) -> tuple[re.Match[str], str] | None:
    for noun in _NOUN.finditer(caption):
        for text in itertools.takewhile(lambda text: text not in _NO_NOUN, noun["words"].lower().split()):
            found = sorted(forms(text) & set(countable))
            if found and (text == found[0] if noun["number"].lower() in _SINGULAR else text.endswith("s")):
                return noun, found[0]
    return None
