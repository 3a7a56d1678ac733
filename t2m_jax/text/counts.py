"""How often a sentence says that something is done: "kicks twice", "three jumps", "takes four steps"."""

import math
import re
from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

from t2m_jax.text.numerals import (
    ABOUT,
    ADVERBS,
    MULTIPLES,
    NUMBER,
    OWNER,
    OWNERS,
    SINGULAR,
    START,
    ends_range,
    number_value,
    pattern,
    without_busy_hands,
    without_others,
)
from t2m_jax.text.subjects import PERSON
from t2m_jax.text.verbs import (
    BODY,
    CLAUSE_STARTS,
    DETERMINERS,
    LIGHT_VERBS,
    PERFORMING_VERBS,
    PREPOSITIONS,
    SIDES,
    SUBJECTS,
    Word,
    forms,
    is_negated,
    readings,
    word_set,
    words_of,
)

MOST_TIMES = 20
"""Most times that a sentence can ask for; more are no motion of some seconds."""

_TIMES = pattern(
    rf"{START}(?:(?P<number>{NUMBER}) (?:times?|reps?|repetitions?)|(?P<adverb>{'|'.join(ADVERBS)})|",
    "(?P<before>\\d{1,6}) ?[x\u00d7]|[x\u00d7](?P<after>\\d{1,6}))(?![\\w-])",
)
_NO_TIMES_AFTER = pattern(r"\b(?:at|all at|every|for|more than|thinks?|thought|was|were) $")
_COMPARED = pattern(r" (?:as|a|an|per|more|again|faster|slower|longer|bigger|higher|larger|every)\b")
"""What stands behind words that do not say how often: "twice as fast"."""
_CLAUSE = pattern(r" (?:the|he|she|it|they|you|his|her|somebody|someone)\b")
"""What stands behind words that say when ("once he sits") or, in the middle of a sentence, of what."""
_NOUN = pattern(
    r"(?<!the )(?<!is )(?<!are )(?<!was )(?<!stands )(?<!standing )",
    rf"{START}(?P<number>{NUMBER})(?: (?:rep|repetition|round)s? of)?(?=(?P<words>(?: [\w-]+){{1,3}}))",
    r"(?!.* at a time\b)",
)
"""A number and the words after it: "takes three big steps". "Sweeps the eight steps" and "is three steps away" say no
number of times."""
_THINGS = word_set("box seat")
"""Nouns that are no actions, although their verbs are."""
_PLACES = word_set("across at down from into off on onto over through up")
"""Words before a number of things that are there: "falls down ten steps"."""
_BENDS = word_set("arc bend circle corner curve loop rotate spin swerve turn veer zigzag")
"""Words for a path that is not straight."""
_NO_NOUN = PREPOSITIONS | CLAUSE_STARTS
_DEFINITE = DETERMINERS - word_set("a an another any no one two three four five six seven eight nine ten")
"""Words before things that are there: "the box"."""
_DOING = PERFORMING_VERBS | LIGHT_VERBS | word_set("add attempt complete deliver go land practice repeat show throw")
"""Verbs whose object is done, not hit: "throws a punch"."""
_BACK = word_set("drop lower release relax return")
"""Verbs of the second half of an action: "raises the arm and lowers it twice"."""
_NO_THING = r"(?![ -](?:corner|direction|door|edge|goal|lane|post|side|wall)\b)"
_NOT_ON = "".join(rf"(?<!\bon {word} )" for word in OWNERS)
"""Not the leg that somebody stands on."""
_ADJECTIVE = r"(?!(?:and|or|then)\b)\w+"
_WITH_SIDE = {
    limb: pattern(
        rf"(?<!'s ){_NOT_ON}\b(left|right)[ -](?:{words})\b{_NO_THING}|",
        rf"\b(left|right) (?:{_ADJECTIVE} )?(?:kick|throw)\b|",
        rf"\bwith {OWNER} (left|right)(?= one\b|$|[.,;!])",
    )
    for limb, words in {"leg": "foot|footed|leg|legged", "arm": "arm|fist|hand|handed"}.items()
}
"""What names the side of an action: "kicks with the right leg", "a left-footed kick", but not "kicks to the left"."""
_LEG_ACTIONS = word_set("kick")
"""Those that are done with a leg."""
_MEASURES = word_set("cm degree feet foot hour inch kg kilo meter metre minute mm month old pound second week year")
"""What a number may be of before an action: "a 7 year old jumps"."""
_GROUPS = pattern(r"\b(?:circle|count|group|line|pair|row|team) of $")
"""What stands before a number of people, or of what is counted aloud."""
_NAMED = pattern(r"(?:(?:^|[,;] ?)(?:(?:an?|the) )?(?:\w+ )?|\b(?P<in>(?:at|for|from|in|of|on) ))(?P<noun>[a-z]+) $")
"""A noun that a number may belong to: "player 2", "in scene 2"."""
_RATE = pattern(r" (?:per|an?|each|every) (?:beat|hour|minute|second)\b")
"""What makes a number of times a rate: "two steps per second"."""
_LAST = pattern(rf"$|[.,;!]| (?:and|while|{'|'.join(sorted(PREPOSITIONS))})\b")
"""What follows the last word of a noun phrase."""
_APART = pattern(r" (?:ahead of|apart|behind)\b")
"""What follows steps that are a distance: "stays two steps behind"."""
_STAIRS = word_set("ascend climb descend fall")
"""Verbs before a number of steps that are there."""
_TO = word_set("at from on to toward towards")
"""Words before a side that is a direction, and one of `OWNERS`: "to the left"."""


class Times(NamedTuple):
    """How often something is done."""

    action: str
    """Basic form of its verb, such as `wave`."""
    sides: frozenset[str]
    """`left`, `right`, or both."""
    number: int


class SaidSide(NamedTuple):
    """With which leg or arm something is done."""

    action: str
    """Basic form of its verb, such as `kick`."""
    side: str
    """`left` or `right`."""


class _Said(NamedTuple):
    """A number of times that a sentence says."""

    number: str
    words: str
    """With the words around it: "three times"."""
    action: str
    """What is done so often; empty if that is nothing that is counted."""


def said_times(caption: str, countable: Collection[str]) -> Times | None:
    """Returns how often a sentence says that an action is done; None if it does not say so.

    Of several numbers of the same action, it is the sum: "two kicks with the left leg, then one kick with the right".

    Args:
        caption: A checked sentence.
        countable: Basic forms of the verbs that can be counted.
    """
    return _times(caption, _find_counts(caption, countable))


def said_side(caption: str, sided: Collection[str]) -> SaidSide | None:
    """Returns with which side a sentence says that an action is done; None if it does not say so.

    Args:
        caption: A checked sentence.
        sided: Basic forms of the verbs that are done with one leg or arm.
    """
    own = without_busy_hands(without_others(caption))
    words = words_of(own)
    done = [word.bases for place, word in enumerate(words) if not is_negated(words[:place])]
    actions = set(sided) & frozenset().union(*done)
    named = _WITH_SIDE["leg" if actions <= _LEG_ACTIONS else "arm"].finditer(own)
    sides = {next(filter(None, found.groups())).lower() for found in named}
    return SaidSide(actions.pop(), sides.pop()) if len(sides) == len(actions) == 1 else None


def uncounted(caption: str, countable: Collection[str]) -> Iterator[tuple[str, str]]:
    """Yields the words of each number of times that no motion is made for, such as "100 times", and why."""
    found = _find_counts(caption, countable)
    is_counted = _times(caption, found) is not None
    for said in found:
        if said.action and not 1 <= number_value(said.number) <= MOST_TIMES:
            yield said.words, f"numbers of times from 1 to {MOST_TIMES} are counted"
        elif countable and not is_counted and number_value(said.number) != 1 and _TIMES.fullmatch(said.words):
            yield said.words, "without effect; one exact number of times of a kick, jump, wave or the like is followed"


def counting_words(caption: str, countable: Collection[str]) -> frozenset[str]:
    """Returns the words of a sentence that say how often, in lower case."""
    found = _find_counts(caption, countable)
    is_counted = _times(caption, found) is not None
    texts = [said.words for said in found if is_counted or _TIMES.fullmatch(said.words)]
    return frozenset(word.text for text in texts for word in words_of(text))


def _times(caption: str, found: Sequence[_Said]) -> Times | None:
    """Returns how often one action is done, None if numbers are about several or about none that is counted."""
    action = found[0].action if found else ""
    count = math.fsum(number_value(said.number) for said in found)
    words = words_of(caption)
    # "Four steps in a curve": the motion has to go on until the curve is done.
    is_path = action == "step" and any(not _BENDS.isdisjoint(word.bases) for word in words)
    is_counted = action and all(said.action == action for said in found)
    if not is_counted or not count.is_integer() or not 1 <= count <= MOST_TIMES or is_path:
        return None
    return Times(action, _sides(words), int(count))


def _sides(words: Sequence[Word]) -> frozenset[str]:
    """Returns the sides that words name, both if they name none. "To the left" is a direction."""
    texts = ["", "", *(text for word in words for text in word.text.split("-")), "", ""]
    sides = set()
    for place in (place for place, text in enumerate(texts) if text in SIDES):
        is_part = not BODY.isdisjoint(forms(texts[place + 1])) and texts[place + 2] != "side"
        if is_part or texts[place - 2] not in _TO or texts[place - 1] not in OWNERS:
            sides.add(texts[place])
    return frozenset(sides) if len(sides) == 1 else SIDES


def _find_counts(caption: str, countable: Collection[str]) -> list[_Said]:
    """Returns all numbers of times of a sentence, without those of other people."""
    own = without_others(caption)
    nouns = dict(_nouns(own, countable))
    # "Five reps of squats" is found in both ways.
    return [*nouns.values(), *(said for begin, said in _verbs(own, countable) if begin not in nouns)]


def _verbs(caption: str, countable: Collection[str]) -> Iterator[tuple[int, _Said]]:
    """Yields where a sentence says "three times" or the like, and of what."""
    for times in _TIMES.finditer(caption):
        before = caption[: times.start()]
        after = caption[times.end() :]
        number = times["number"] or times["adverb"] or times["before"] or times["after"]
        is_first = not before.strip()
        is_when = number.lower() == "once" and (is_first or _CLAUSE.match(after))
        is_of_what = not is_first and _CLAUSE.match(after)  # "twice the size"
        if _NO_TIMES_AFTER.search(before) or _COMPARED.match(after) or is_when or is_of_what:
            continue
        action = _counted(words_of(before), countable)
        if action is None:  # "twice, she bows"
            action = next((word.action for word in words_of(after) if word.action), "")
        is_counted = action in countable and not ends_range(before)
        yield times.start(), _Said(number, times[0], action if is_counted else "")


def _counted(words: Sequence[Word], countable: Collection[str]) -> str | None:
    """Returns the action of a number of times after words, empty for one that is not counted, None for no action.

    It is the last one: of "jumps and spins twice", nobody knows how often to jump.
    """
    thing: str | None = None
    for index, word in reversed(list(enumerate(words))):
        counted = {word.action} & set(countable)
        noun = word.bases & set(countable)
        if counted or (noun and not _is_thing(words, index, countable)):
            return "" if is_negated(words[:index]) else min(counted or noun)
        thing = thing or min(noun, default=None)
        # "Jumps ten times, holding a box" is about the jump, but "spinning three times" about the spin.
        is_beside = word.text.endswith("ing") and index < len(words) - 1
        if word.action and word.action not in _DOING | _BACK and not is_beside:
            return ""
    return thing


def _is_thing(words: Sequence[Word], index: int, countable: Collection[str]) -> bool:
    """Returns whether a noun is not what is done: "kicks the box", "jumps off the step", but not "throws a punch"."""
    if words[index].action:
        return False
    for word in words[:index][::-1]:
        if word.text in _DEFINITE:
            return True
        if word.action or word.text in _NO_NOUN:
            return word.action in countable and word.action not in _DOING
    return False


def _nouns(caption: str, countable: Collection[str]) -> Iterator[tuple[int, _Said]]:
    """Yields where a sentence has a number before the noun of an action, as "two punches", but not "one hand waves"."""
    for noun in _NOUN.finditer(caption):
        before = caption[: noun.start()]
        number = noun["number"].lower()
        action = _counted_noun(noun, countable, before)
        is_done = bool(action) and (number in MULTIPLES or _is_doing(before, action))
        if is_done and not (_GROUPS.search(before) or _is_name(before)):
            is_meant = not is_negated(words_of(before)) and not ends_range(before)
            yield noun.start(), _Said(noun["number"], noun["number"], action if is_meant else "")


def _counted_noun(noun: re.Match[str], countable: Collection[str], before: str) -> str:
    """Returns the action among the words behind a number; empty if the number is about something else there."""
    is_one = noun["number"].lower() in SINGULAR
    for word in re.finditer(r"[\w-]+", noun["words"].lower()):
        bases = forms(word[0])
        action = min(bases & set(countable), default="")
        after = noun["words"][word.end() :] + noun.string[noun.end("words") :]
        # "Seven step to the front" has a mistake.
        is_plural = not is_one and (word[0].endswith("s") or (word.start() == 1 and _LAST.match(after)))
        if action and (is_plural or (is_one and word[0] == action)):
            is_distance = action == "step" and _APART.match(after) and "tak" not in before
            return "" if action in _THINGS or _RATE.match(after) or is_distance else action
        # "A 7 year old jumps", "three men and kicks", "with two dogs jumps".
        are_others = word[0].endswith("s") and "NOUN" in readings(word[0]) and "ADJ" not in readings(word[0])
        if are_others or word[0] in _NO_NOUN | SUBJECTS or not (_MEASURES | PERSON).isdisjoint(bases):
            return ""
    return ""


def _is_name(before: str) -> bool:
    """Returns whether a number after a text is the name of something: "player 2"."""
    found = _NAMED.search(before)
    if found is None or found["noun"] in DETERMINERS or not BODY.isdisjoint(forms(found["noun"].lower())):
        return False
    kinds = readings(found["noun"].lower()).keys()
    return kinds == {"NOUN"} or (found["in"] is not None and "NOUN" in kinds)


def _is_doing(before: str, action: str) -> bool:
    """Returns whether a number of nouns after a text is done: "does two jumps", but not "rides two waves"."""
    words = [word for word in words_of(before) if word.text not in ABOUT]
    # "Spins, two kicks and a jump".
    if not words or before.rstrip().endswith(","):
        return True
    if words[-1].text in _NO_NOUN | _PLACES:
        return words[-1].text not in _PLACES
    verbs = [word.action for word in words if word.action]
    if action == "step":
        return _STAIRS.isdisjoint(verbs[-1:])
    return not verbs or verbs[-1] == action or verbs[-1] in _DOING
