"""Sentences that say several actions in turn: "walks, then waves", "before she sits down, she bows"."""

import itertools
import re
from collections.abc import Callable, Collection, Iterable, Iterator
from typing import NamedTuple

from t2m_jax.text.clauses import fill_in, name_part, only_ends
from t2m_jax.text.coverage import has_action
from t2m_jax.text.directions import find_turn, goes_somewhere, only_turns_to_side
from t2m_jax.text.verbs import (
    BODY_PARTS,
    DETERMINERS,
    PREPOSITIONS,
    SIDES,
    bases_of,
    form_of,
    forms,
    readings,
    word_set,
    words_of,
)

_PERSON = r"(?:he|she|it|they|you|somebody|someone)"
_JUST = r"(?:(?:right|just|only|shortly|soon|immediately|directly|straight) )?"
_AND = r"(?:,|;| and|, and|; and| but|, but)"
_AFTER_THAT = r"(?:right |shortly |soon )?after (?:that|this|which)"
_THEN = rf"(?:then(?! and there)|afterwards?|{_AFTER_THAT}|subsequently|thereafter|whereupon)"
# Words that say an order only behind a comma or an "and": not "a next step" or "walks next to it".
_LATER = r"(?:next(?! to)|finally|lastly|eventually|(?:a \w+ |a (?:bit|little) )?later|at last|in the end|at the end)"
_NO_ORDER = r"(?<!now and)(?<!\bby)(?<!since)(?<!until)(?<!back)"
_TIME = r"(?:another|each|one|a while|[\w ]{0,20}(?:second|minute|moment|step|meter|pace|time)s?)\b"
_CLAUSE = rf"(?= (?:{_PERSON}|the|his|her|its|their) )"
_DONE = rf"(?= {_PERSON} (?:has|have|had|(?:is|are)(?! (?:\w+ly )?\w+ing\b)) )"
_AFTER = rf"{_JUST}(?:after(?! {_TIME})|once{_CLAUSE}|upon|as soon as|when{_DONE})"
_BEFORE = rf"{_JUST}(?:before|prior to)"
MAX_ACTIONS = 20
"""A sentence with more actions is left whole."""

GOING = word_set("go head hurry jog march move pace run step stride stroll walk wander")
"""Verbs of going. Before or after one, a turn is a corner of the way."""
RUNNING = word_set("jog run")
TURNING = word_set("back bend turn")
"""Verbs that say no more than another direction."""
_REVERSALS = word_set("180 around back backward backwards opposite")
_SIDE = re.compile(r"\b(?:left|right|around|corner)\b", re.IGNORECASE)

_NEGATED = re.compile(r"\b(?:not|never)\b|n't\b|^(?:if|unless)\b", re.IGNORECASE)
_AT_ONCE = r"(?:meanwhile|simultaneously|at the same time|all the while)\b"
_TOGETHER = re.compile(rf"{_AT_ONCE}.*|.*[.;,] {_AT_ONCE}", re.IGNORECASE)
"""A part that begins or ends so is done together with the other."""


class _Order(NamedTuple):
    """A way to say an order."""

    pattern: re.Pattern[str]
    """With the groups `first` and `second`, in the order in which they happen."""
    clause: str = ""
    """Which of them is only a clause, and perhaps a time or a place: "until the end", "before the door"."""


def _order(pattern: str, clause: str = "") -> _Order:
    return _Order(re.compile(pattern, re.IGNORECASE), clause)


_ORDERS = (
    _order(r"(?P<first>.+?) ?(?:->|=>|\u2192) ?(?P<second>.+)"),
    _order(r"(?:\d[.)] )?(?P<first>.+?)[,;.]? \d[.)] (?P<second>.+)"),
    # "Walks in and, before sitting down, waves": what comes later is cut again.
    _order(rf"(?P<first>.+?){_AND},? (?P<second>(?:{_AFTER}|{_BEFORE}|having) [^,]+, .+)"),
    _order(r"(?P<second>.+?),? but (?P<first>.+?) first"),
    _order(rf"(?P<second>.+?)[.;!] {_BEFORE} (?:that|this),? (?P<first>.+)"),
    _order(rf"(?P<second>.+?),? but (?:only )?(?:first|{_BEFORE} that),? (?P<first>.+)"),
    _order(rf"(?P<second>.+?){_AND} {_BEFORE} (?:that|this|which),? (?P<first>.+)"),
    _order(r"(?P<second>.+?), having (?:previously |already |first |just )?(?P<first>.+)", "first"),
    _order(rf"{_BEFORE} (?P<second>(?:{_PERSON} )?[^,]+?) (?P<first>{_PERSON} .+)", "second"),
    _order(rf"{_BEFORE} (?P<second>.+?), (?P<first>.+)", "second"),
    _order(rf"(?:{_AFTER}|having) (?P<first>(?:{_PERSON} )?[^,]+?) (?P<second>{_PERSON} .+)", "first"),
    _order(rf"(?:{_AFTER}|having) (?P<first>.+?), (?P<second>.+)", "first"),
    _order(r"(?P<first>.+?)[.;!](?: |(?-i:(?<=[a-z].)(?=[A-Z])))(?P<second>.+)"),
    _order(rf"(?P<first>.+?){_NO_ORDER}(?:{_AND}? |\.\.\.? ?){_THEN},? (?P<second>.+)"),
    _order(r"(?P<first>.+?),? followed (?:[\w ]{1,20} )?by (?P<second>.+)"),
    _order(rf"(?P<first>.+?){_AND} {_LATER},? (?P<second>.+)"),
    _order(rf"(?P<first>.+?){_AND} (?P<second>[^,]+?),? (?:afterwards?|{_AFTER_THAT}|subsequently|thereafter)"),
    _order(r"(?P<second>.+?),? (?:but |though )?not (?:before|until) (?P<first>.+)", "first"),
    _order(rf"(?P<second>.+?),? (?:but |and )?{_AFTER} (?P<first>.+)", "first"),
    _order(rf"(?P<first>.+?),? {_BEFORE} (?P<second>.+)", "second"),
    _order(rf"(?P<first>.+?),? (?:un)?till? (?P<second>(?:{_PERSON} |\w+ing ).+)", "second"),
)
_SEAT = r"(?:out of|off|from) (?:\w+ ){1,2}(?:armchair|bed|bench|chair|couch|seat|sofa|stool)"
_STANDS_UP = (
    rf"\b(?:(?:stands?|stood|gets?|got|rises?|rose) (?:back )?(?:up|{_SEAT})|(?:gets?|got) to \w+ feet|bow(?:s|ed)?)\b"
)
_LEAVES_STANDING = r"(?:(?:sits?|sat|lies?|lay|kneels?|knelt) (?:back )?down|bow(?:s|ed)?)\b"
_RISING = re.compile(rf"(?P<first>.*?{_STANDS_UP}.*?),? and (?:{_PERSON} )?(?P<second>.+)", re.IGNORECASE)
_SINKING = re.compile(rf"(?P<first>.+?),? and (?:{_PERSON} )?(?P<second>{_LEAVES_STANDING}.*)", re.IGNORECASE)
"""Two actions around an "and" that need two postures: "stands up and walks", "waves and sits down"."""
_ARRIVED = re.compile(rf"(?P<first>.+?),? and (?:{_PERSON} )?(?P<second>.+)", re.IGNORECASE)
"""Two actions around an "and", of which one is the way to a place, or a turn: "walks in and waves"."""
_PLACES = word_set("back box fence floor last place seat second train ward window")
"""Known verbs that are something else behind "to the door and" or "before the"."""
_OBJECTS = word_set("at down her him himself herself it itself off on out them up")
"""Words that make a verb of a word before them that may be a noun: "opens it", "leans on the bar"."""
_ON_THE_WAY = re.compile(
    r"^(?:carr\w+|go\w*|went|mov\w+|walk\w*|r[au]n\w*) on\b|^(?:keep\w*|kept|continu\w+)\b|"
    rf"\b(?:all the way|on the way|(?:as|while) (?:{_PERSON}|\w+ing)|the (?:entire|whole) (?:time|way))\b",
    re.IGNORECASE,
)
"""What says that an action is done while somebody goes, or that he goes on."""
_LIST = re.compile(r"(?P<first>[^,]+),(?: and)? (?P<second>.+)")
_BY_STEPS = re.compile(r"(\w+) (?:after|by) \1\b", re.IGNORECASE)
_OPENING = re.compile(
    rf"(?:(?:and|but|first(?:ly)?|second(?:ly)?|first of all|{_THEN}|{_LATER}|having|is|comes),? )+", re.IGNORECASE
)


def split_sequence(caption: str, known: Collection[str]) -> tuple[str, ...]:
    """Returns the actions of a sentence in the order in which they happen, each as a sentence.

    It is cut at words such as `then`, `before`, `after` and `followed by`, in a list of verbs, and at an "and" beside a
    way to a place, a turn or another posture ("walks in and waves"), if there is an action on both sides: "runs after
    the bus" is one action, and so are walking around a corner and raising a hand and lowering it. What only names
    another side is filled in: "waves with the left hand, then the right" is two waves. A turn to a side before or after
    another action is on the spot. Other sentences are returned whole, also those with `not`.

    Args:
        caption: A checked sentence.
        known: Actions that the model knows; without a record of them, no sentence is cut.
    """
    if not known:
        return (caption,)
    actions = _with_corners(_split(caption, lambda text: has_action(words_of(text), known)), known)
    if not 1 < len(actions) <= MAX_ACTIONS:
        return (caption,)
    return tuple(f"{action} on the spot" if only_turns_to_side(action) else action for action in actions)


def _split(text: str, is_known: Callable[[str], bool]) -> Iterator[str]:
    for first, second in _cuts(text.rstrip(". "), is_known):
        is_together = any(map(_TOGETHER.fullmatch, (first, second)))
        if not (is_together or only_ends(first, second) or _NEGATED.search(f"{first} {second}")):
            yield from _split(first, is_known)
            yield from _split(second, is_known)
            return
    yield text


def _with_corners(actions: Iterable[str], known: Collection[str]) -> list[str]:
    """Returns actions in which walking around a corner is one: "walks, then turns left and walks on"."""
    joined: list[str] = []
    has_corner = False
    for action in actions:
        before = joined[-1] if joined else ""
        # A way with a corner is not the corner of the next one.
        if _is_corner(action, before, known) or (not has_corner and _is_corner(before, action, known)):
            joined[-1] = f"{before}, then {action}"
            has_corner = True
        else:
            joined.append(action)
            has_corner = False
    return joined


def _is_corner(action: str, neighbor: str, known: Collection[str]) -> bool:
    """Returns whether an action is nothing but another direction of somebody who goes, which its neighbor says."""
    going = GOING & bases_of(words_of(neighbor))
    # Of two turns, neither is the corner of the other, and who turns around stands.
    if find_turn(action) or not going or not _SIDE.search(action) or _SIDE.search(neighbor):
        return False
    words = words_of(action)
    ways = GOING & bases_of(words) & set(known)
    others = set(known) - TURNING - ways
    if any(word.action and others & word.bases for word in words):
        return False
    texts = [word.text for word in words]
    # "The left hand goes up".
    names_part = any(text in SIDES and BODY_PARTS & forms(after) for text, after in itertools.pairwise(texts))
    # "Turns left and walks on" is a corner after "walks", but not after "runs"; "turns around and walks back" is none.
    is_same_gait = bool(ways & RUNNING) == bool(going & RUNNING)
    is_turn = bool(TURNING & bases_of(words) and SIDES & set(texts)) and _REVERSALS.isdisjoint(texts)
    return not names_part and (not ways or (is_same_gait and is_turn))


def _cuts(text: str, is_known: Callable[[str], bool]) -> Iterator[tuple[str, str]]:
    """Yields the ways to cut a text in two, the best first."""

    def is_action(part: str) -> bool:
        head = _head(part)
        return is_known(head) or _has_verb(head)

    for order in _ORDERS:
        if (found := order.pattern.fullmatch(text)) is not None:
            parts = {name: _without_opening(found[name]) for name in ("first", "second")}
            first = name_part(parts["first"], parts["second"])
            second = name_part(parts["second"], parts["first"])
            is_doing = not order.clause or _is_doing(parts[order.clause], is_known)
            if (full := fill_in(first, second)) is not None:
                yield full
            elif is_action(first) and is_action(second) and is_doing:
                yield first, second
    for first, second in _parts(_ARRIVED, text):
        if _is_done_there(first, second) and (_goes_on(second, is_known) or _begins_with_verb(second)):
            yield first, second
    for first, second in [*_parts(_RISING, text), *_parts(_SINKING, text), *_parts(_LIST, text)]:
        if _goes_on(second, is_known) and is_action(first):
            yield first, second


def _is_done_there(first: str, second: str) -> bool:
    """Returns whether the second of two actions can only begin when the first one has ended."""
    is_place = not _PLACES.isdisjoint(forms(re.split(r"\W", second.lower())[0]))
    # "And swings left at the end" is a corner.
    is_way = _SIDE.search(second) and not BODY_PARTS & bases_of(words_of(second)) and not find_turn(second)
    # "Through the cool and clean hall": a verb behind another one has its form.
    verbs = {form_of(word.text) for word in words_of(first) if word.action}
    is_no_verb = verbs and form_of(re.split(r"\W", second)[0]) not in verbs
    if is_place or is_way or is_no_verb or _ON_THE_WAY.search(second):
        return False
    return any(goes_somewhere(part) or find_turn(part) for part in (first, second))


def _begins_with_verb(text: str) -> bool:
    """Returns whether the first word of a text is a verb, also of an action that the model does not know."""
    first, second, *_ = [*re.split(r"\W+", text.lower()), ""]
    found = readings(first)
    is_other = not {"ADJ", "NOUN"}.isdisjoint(found) and second not in DETERMINERS | _OBJECTS
    return "VERB" in found and not is_other and not first.endswith("ing")


def _parts(pattern: re.Pattern[str], text: str) -> list[tuple[str, str]]:
    """Returns the first and the second part of a text that matches a pattern."""
    found = pattern.fullmatch(text)
    return [] if found is None else [(found["first"], found["second"])]


def _without_opening(part: str) -> str:
    """Returns a part without the words that say its place in the order."""
    part = part.strip(" ,;").removesuffix(" and")
    opening = _OPENING.match(part)
    return part[opening.end() :] if opening is not None else part


def _has_verb(text: str) -> bool:
    return any(word.action for word in words_of(text))


def _head(part: str) -> str:
    """Returns a part up to the first comma or "and": "the door and waves" has an action, "the door" has none."""
    return re.split(r",| and ", part)[0]


def _is_doing(clause: str, is_known: Callable[[str], bool]) -> bool:
    """Returns whether a clause says what the person does. What others do is hardly an action that the model knows."""
    head = _head(clause)
    if head.partition(" ")[0].lower() in DETERMINERS and not _has_verb(head):
        # "Before the window" and "after a jumping dog" name things, "after a kick" an action.
        thing = list(itertools.takewhile(lambda word: word.text not in PREPOSITIONS, words_of(head)))[-1]
        return is_known(thing.text) and _PLACES.isdisjoint(thing.bases)
    return is_known(head) or (head.partition(" ")[0].endswith("ing") and _has_verb(head))


def _goes_on(text: str, is_known: Callable[[str], bool]) -> bool:
    """Returns whether a text begins with another action. "Dragging a foot" and "step by step" say a manner."""
    if _BY_STEPS.match(text):
        return False
    word = re.split(r"\W", text)[0]
    return (is_known(word) or goes_somewhere(text, at_once=True)) and not word.endswith("ing")
