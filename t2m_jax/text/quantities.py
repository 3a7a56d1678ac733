"""How long a sentence says that its motion lasts, "for five seconds", and which amounts nothing follows."""

import re
from collections.abc import Collection, Iterator

from t2m_jax.text.counts import counting_words
from t2m_jax.text.numerals import ABOUT, NUMBER, START, ends_range, number_value, pattern, without_others
from t2m_jax.text.verbs import bases_of, word_set, words_of

LONGEST = 600.0
"""Longest motion in seconds that a sentence can ask for; more is hardly meant."""

_TIME = pattern(
    rf"{START}(?:(?P<number>{NUMBER})|(?:(?<=for )|^)(?:(?:{'|'.join(ABOUT)}) )?(?P<a>a))",
    r"(?P<half> and a half)?(?: full| whole| long)?",
    r"(?:[ -]?(?P<unit>seconds?|secs?|minutes?|mins?)|(?<=\d) ?s)\b(?P<later> and a half)?",
)
_OTHER_AMOUNT = pattern(
    r"(?P<range>(?<![\w.])\d+ ?[-\u2013] ?\d+ ?(?:s|secs?|seconds?|mins?|minutes?)\b)|",
    rf"{START}(?:(?:{NUMBER})[ -]?|an? )(?:(?P<degree>degrees?)|(?P<second>hours?|milliseconds?|ms)|",
    r"(?P<meter>met(?:er|re)s?|kilomet(?:er|re)s?|km|cm|m|miles?|yards?|inch(?:es)?|(?<!two )(?<!2 )feet)",
    r"(?! (?:high|tall|wide|deep|long|per|away|apart|off|above|from)))\b",
)
ADVICE = {
    "range": "the option `seconds` sets the length",
    "degree": "the option `turn` bends the path of a sentence without a turn",
    "meter": "the option `path` leads through points in meters",
    "second": "the option `seconds` sets the length",
}
"""What a person may use in place of an amount, by its unit."""
_AND = pattern("(?:,|,? and)? ?")
"""What stands between minutes and seconds."""
_NO_LENGTH_AFTER = pattern(
    r"(?<!stop )(?<!stops )(?<!ends )(?<!stopped )(?<!stopping )",
    r"\b(?:after|another|at|before|by|count(?:s|ed|ing)? to|each|every|first|from|(?<!should )last|(?<!for the )next|",
    r"once|only|per|since|than|till|until|within)",
    r"(?: (?:the|a|an|about|around|roughly|first|last|next|only|exactly))* $",
)
"""What stands before a time that is no length: "after three seconds", but not "stops after three seconds"."""
_NO_LENGTH_BEFORE = pattern(
    r"[ -]+(?:long )?(?:after|ago|alarm|apart|before|break|countdown|delay|each|earlier|egg|film|gap|",
    r"in(?:to)?\b(?! \w)|in,|interval|late|left(?:$|[.,;]| on\b)|mark|movie|pause|phone|remaining|rest|song|time ?out|",
    r"timer|to go|to spare|too|video|warning)",
)
_DECADE_AFTER = pattern(r"\b(?:his|her|their|my|your|the|early|mid|late)[ -]$")
_DECADE_BEFORE = pattern(
    r" (?:clothes|dances?|disco|fashion|hip|looks?|movies?|music|outfits?|rock|shows?|style|television|tv)\b"
)
"""What stands around "70s" if it is a decade or an age."""
_PAUSES = word_set("freeze hesitate hold pause rest wait")
_STOPS = word_set("halt stop")
_STANDS_STILL = pattern(r"\b(?:stands?|standing|stood|stays?|staying|stayed) still (?:for )?$")
_GOES_ON = pattern(r",?(?: and)?(?: then)? \w+s\b")
"""What stands around a pause: "stands still for two seconds, then walks"."""
_NO_MOTION = pattern(r"(?:\b(?:never|nobody|not)|n['\u2019]t)\b[^,.;:]*$")
"""What stands before the length of something that is not done."""


def said_seconds(caption: str) -> float | None:
    """Returns how many seconds a sentence says that its whole motion lasts; None if it does not say so.

    "After three seconds", "every second" and "waits a second before waving" say no length.
    """
    seconds = sum(map(_seconds, _find_length(caption)))
    return seconds if 0 < seconds <= LONGEST else None


def quantity_words(caption: str, countable: Collection[str] = ()) -> frozenset[str]:
    """Returns the words of a sentence that say how long or how often, in lower case.

    `countable` are the basic forms of the verbs that can be counted, as in "four steps".
    """
    times = (word.text for time in _find_length(caption) for word in words_of(time[0]))
    return counting_words(caption, countable) | frozenset(times)


def unread_amounts(caption: str) -> Iterator[tuple[str, str]]:
    """Yields the amounts that a sentence says and no motion follows, such as "90 degrees", and what gives them.

    A time is one if it may be how long the motion lasts: in "for two to three seconds", not in "every two seconds".
    """
    own = without_others(caption)
    for amount in _OTHER_AMOUNT.finditer(own):
        yield amount[0], ADVICE[amount.lastgroup or ""]
    for time in _TIME.finditer(own) if said_seconds(caption) is None else ():
        before = own[: time.start()]
        after = own[time.end() :]
        if not (_is_decade(time, own) or _is_apart(before, after) or _is_pause(before, own) or _is_undone(before)):
            yield time[0], ADVICE["second"]


def _seconds(time: re.Match[str]) -> float:
    number = 1.0 if time["a"] else number_value(time["number"])
    if time["half"] or time["later"]:
        number += 0.5
    return 60 * number if (time["unit"] or "s").lower().startswith("m") else number


def _find_length(caption: str) -> list[re.Match[str]]:
    """Returns where a sentence says the length of its motion. Of two times, neither can be it, but for "1 min 30 s"."""
    own = without_others(caption)
    found = [time for time in _TIME.finditer(own) if not _is_decade(time, own)]
    if len(found) == 2 and _AND.fullmatch(own[found[0].end() : found[1].start()]):
        is_one = (found[0]["unit"] or "s")[0] in "mM" and (found[1]["unit"] or "s")[0] in "sS"
    else:
        is_one = len(found) == 1
    return found if is_one and _is_length(own[: found[0].start()], own[found[-1].end() :], own) else []


def _is_length(before: str, after: str, caption: str) -> bool:
    """Returns whether a time between two texts is how long a motion lasts."""
    is_other = _is_apart(before, after) or ends_range(before)
    return not (is_other or _is_pause(before, caption) or _is_undone(before))


def _is_apart(before: str, after: str) -> bool:
    """Returns whether a time between two texts says when, and not how long."""
    waits = _STANDS_STILL.search(before) and _GOES_ON.match(after)
    return bool(_NO_LENGTH_AFTER.search(before) or _NO_LENGTH_BEFORE.match(after) or waits)


def _is_undone(before: str) -> bool:
    """Returns whether what a length is about is not done. "Does not stop for ten seconds" is done."""
    found = _NO_MOTION.search(before)
    return found is not None and bases_of(words_of(found[0])).isdisjoint(_STOPS | _PAUSES)


def _is_decade(time: re.Match[str], caption: str) -> bool:
    """Returns whether "70s" is no time but a decade or an age."""
    before = caption[: time.start()]
    if time["unit"] or before.lower().endswith("for ") or number_value(time["number"]) % 10:
        return False
    return bool(_DECADE_AFTER.search(before) or _DECADE_BEFORE.match(caption[time.end() :]))


def _is_pause(before: str, caption: str) -> bool:
    """Returns whether a time after a text may be that of a pause, and not that of all that is done."""
    actions = {word.action for word in words_of(caption) if word.action}
    last = [word.action for word in words_of(before) if word.action][-1:]
    stops = not before.endswith("after ") and not _STOPS.isdisjoint(last)
    return len(actions) > 1 and (stops or not actions.isdisjoint(_PAUSES))
