"""What a sentence asks legs and arms to do at the same time: "walks backward while waving the left hand"."""

from collections.abc import Sequence
from typing import NamedTuple

from t2m_jax.text.numerals import OWNER, pattern, without_busy_hands, without_others
from t2m_jax.text.paces import GAITS
from t2m_jax.text.sequence import split_sequence
from t2m_jax.text.subjects import ANIMALS, CROWDS, PERSON
from t2m_jax.text.verbs import BODY, DETERMINERS, LIGHT_VERBS, SIDES, Word, is_negated, word_set, words_of

LONGEST = 200
"""Characters. Longer sentences say more than one thing, and take long to read."""
_GOES = pattern(
    r"\b(?:advanc\w+|go|goes|going|went|head(?:s|ed|ing)|mov(?:e|es|ed|ing)|step(?:s|ped|ping)?) ",
    r"(?:\w+ly )?(?:ahead|along|forwards?|on(?!ce)|onwards?|straight|to(?:wards?)?)\b",
)
"""Other words for "walk". "The left hand goes up" is none."""
_GAIT_NOUN = pattern(
    r"\b(?:during|on|mid|in|for) (?:(?:a|an|the|his|her|their|your|my) )?(?:\w+ )?(?P<noun>walk|stroll|run|jog)\b"
)
"""A gait in "lifts both arms during a walk"."""
_BACKWARD = pattern(
    r"\b(?:backwards?|in reverse|retreat\w*|back(?:s|ed|ing)? (?:away|off|up)|(?:mov\w+|step\w*) back)\b"
)
_TURNS = pattern(
    r"\b(?:turn\w*|corner|curv\w+|bend(?:s|ing)?|bent|veer\w*|rounds?|rounding|arcs?|go|goes|going|went|takes?|taking|",
    r"hang\w*|swing\w*|bear\w*)\b",
)
_OTHER_PATHS = pattern(
    r"\b(?:around(?! (?:a|an|the) (?:\w+ )?(?:bend|corner|curve|turn)\b)|back and forth|circl\w+|diagonal\w*|",
    r"downstairs|figure|ladder|side ?step\w*|sideways?|slope|spiral\w*|stairs?|staircase|to and fro|",
    r"turn\w* (?:a?round|back)|upstairs|zig\S*)\b",
)
"""Paths that are not straight, a corner or backward."""
_BODY = r"(?:arms?|fingers?|fists?|hands?|palms?|wrists?)"
_HAND = pattern(
    rf"\b(?:(?P<side>left|right)(?: and (?P<other>left|right))? (?:{_BODY}|one)|",
    rf"(?:(?P<many>both|two)(?: \w+){{0,2}} )?{_BODY})\b",
)
_MANY = pattern(r"\b(?:arms|hands|fists)\b")
_WITH = pattern(rf"\bwith {OWNER} (left|right)(?= *(?:$|[.,;!?]))")
"""A hand that is named by its side alone: "waves with her left"."""
_OTHER = pattern(rf"\b(?:other|opposite)(?: (?:{_BODY}|one)\b|$|[,.!])")
_DIRECTION = pattern(rf"\b(?P<side>left|right)\b(?!(?:[ -]hand\w*)|(?: and (?:left|right))? (?:{_BODY}|one)\b)")
_HIGH = (
    r"(?:up(?! (?:an?|the|to)\b)|high|overhead|aloft|skywards?|above|over (?:his|her|their|your|my|its|the) head|"
    r"in(?:to)? the air|to(?:wards?)? the (?:sky|ceiling))\b"
)
_UP = pattern(
    rf"\b{_BODY}(?: (?!down\b)\w+){{0,3}} {_HIGH}|",
    rf"\b(?:held|hold\w*|keep\w*|kept|put\w*|reach\w*|stick\w*|stuck|thr[eo]w\w*|thrust\w*) (?:up|{_HIGH})",
    rf"(?: \w+){{0,3}} {_BODY}\b",
)
"""A hand that is up. "Hands in pockets, up the hill" is none."""
_RAISES = word_set("elevate extend hoist lift raise stretch")
_WAVES = word_set("wave")
_CLAPS = word_set("applaud clap")
_PUNCHES = word_set("jab punch shadowbox")
_IN_TURN = pattern(
    r"(?<!\bran )(?<!\brun )(?<!\bruns )(?<!\brunning )\bafter\w*|",
    r"\b(?:before|finally|first|followed|lower\w*|next|then|till|until)\b",
)
"""Words of an order, but not "runs after the bus". Not all such sentences are cut."""
_WHO = pattern(r"\b(?:that|which|who|whose)\b")
"""What begins a clause about somebody else."""
_MET = pattern(
    r"(?P<met>\b(?:after|around|at|behind|beside|by|from|near|past|to|towards?|with) ",
    r"(?:an?|another|her|his|some|the|their|two) (?:\w+ )?(?P<who>\w+)) \w+ing\b[^,;]*",
)
_OTHERS = PERSON | CROWDS | ANIMALS
"""Whom somebody may meet."""
_TO_THINGS = word_set(
    """across after against along around at behind beside between by from into near off on onto over past through to
    toward towards under"""
)
"""Words before things: "past a punching bag", "into the waves"."""
_HANDS = word_set("arm finger fist hand palm wrist")
"""Parts of the body that are raised with a hand."""
_CLAUSE = pattern(r"(?:,|;|\b(?:and|as|but|while)\b)")
_ACTIONS = frozenset().union(*GAITS.values(), _RAISES, _WAVES, _CLAPS, _PUNCHES)


class SaidAtOnce(NamedTuple):
    """What legs and arms are to do at the same time."""

    legs: str
    """`walk`, `run`, `backward`, `left` or `right` (who goes ahead and turns); empty for another path."""
    arms: str
    """`clap`, `punch`, `raise` or `wave`."""
    hands: frozenset[str]
    """Of `left` and `right`, those that are raised or wave; none if the sentence does not say which."""


_LEGS = {
    "walk": "walks forward",
    "run": "runs forward",
    "backward": "walks backward",
    "left": "walks and turns left",
    "right": "walks and turns right",
}
_ARMS = {"clap": "clapping", "punch": "punching", "raise": "raising", "wave": "waving"}


def in_plain_words(said: SaidAtOnce) -> str:
    """Returns a sentence for what legs and arms do that says nothing else; empty if legs go another way."""
    if not said.legs:
        return ""
    hands = {0: " a hand", 1: f" the {''.join(said.hands)} hand", 2: " both hands"}
    what = hands[len(said.hands)] if said.arms in ("raise", "wave") else ""
    return f"a person {_LEGS[said.legs]} while {_ARMS[said.arms]}{what}"


def said_at_once(caption: str) -> SaidAtOnce | None:
    """Returns what a sentence asks legs and arms to do; None if it does not name both, or says that one is not done.

    Who does one after the other does not do them at once. Sentences of more than `LONGEST` characters are not read.
    """
    if len(caption) > LONGEST:
        return None
    own = _without_others(caption)
    if _IN_TURN.search(own):
        return None
    words = words_of(own)
    arms = _arms(own, words)
    legs = _legs(own, words) if arms else None
    if not arms or legs is None or len(split_sequence(caption, _ACTIONS)) > 1:
        return None
    return SaidAtOnce(legs, arms, _hands(own, arms) if arms in ("raise", "wave") else frozenset())


def _without_others(caption: str) -> str:
    """Returns a sentence without what it says of others: "to a friend who waves", "past a man waving"."""
    own = without_others(caption)
    for found in _WHO.finditer(own):
        # "There is somebody who walks" is about the person.
        if any(word.action not in LIGHT_VERBS | {""} for word in words_of(own[: found.start()])):
            own = own[: found.start()]
            break
    return _MET.sub(lambda found: found["met"] if words_of(found["who"])[0].bases & _OTHERS else found[0], own)


def _arms(text: str, words: Sequence[Word]) -> str:
    has_hand = _HAND.search(text) is not None
    for action, verbs in (("wave", _WAVES), ("clap", _CLAPS), ("punch", _PUNCHES)):
        if _places(words, verbs, also_nouns=has_hand or action != "wave"):
            return action
    raised = _places(words, _RAISES, also_nouns=True)
    is_raised = has_hand and (_UP.search(text) or any(_moves_hands(words, place) for place in raised))
    return "raise" if is_raised else ""


def _places(words: Sequence[Word], verbs: frozenset[str], *, also_nouns: bool = False) -> list[int]:
    """Returns where words say that somebody does what one of some verbs says; a noun may be enough for that."""
    found = [place for place, word in enumerate(words) if word.bases & verbs]
    places = [place for place in found if words[place].action or (also_nouns and not _is_thing(words, place))]
    return [] if any(is_negated(words[:place]) for place in places) else places


def _is_thing(words: Sequence[Word], place: int) -> bool:
    """Returns whether a noun or a participle names where somebody goes: "past a punching bag"."""
    before = [word.text for word in words[max(place - 3, 0) : place]][::-1]
    start = next((index for index, text in enumerate(before) if text in DETERMINERS), None)
    if start is None or start + 1 == len(before):
        return bool(before) and before[0] in _TO_THINGS
    return before[start + 1] in _TO_THINGS or before[start : start + 2] == ["the", "in"]


def _moves_hands(words: Sequence[Word], place: int) -> bool:
    """Returns whether the part of the body that a verb moves, the first one behind it or the last before, is a hand."""
    parts = [word.bases for word in words[place:] if word.bases & BODY] or [
        word.bases for word in words[:place][::-1] if word.bases & BODY
    ]
    return bool(parts and parts[0] & _HANDS)


def _hands(text: str, arms: str) -> frozenset[str]:
    """Returns the hands that do something, without those that do something else at the same time."""
    free = without_busy_hands(text)
    doing = [clause for clause in _CLAUSE.split(free) if _arms(clause, words_of(clause)) == arms]
    found = [hand for clause in doing for hand in _HAND.finditer(clause)] or list(_HAND.finditer(free))
    named = [side for hand in found for side in hand.group("side", "other") if side]
    named += [side for clause in doing or [free] for side in _WITH.findall(clause)]
    sides = {side.lower() for side in named}
    busy = SIDES.intersection(text.lower().split()) - SIDES.intersection(free.lower().split())
    if not sides and len(busy) == 1 and any(map(_OTHER.search, doing or [free])):
        return SIDES - busy
    if not sides and any(one["many"] or _MANY.search(one[0]) for one in found):
        return SIDES
    return frozenset(sides)


def _legs(text: str, words: Sequence[Word]) -> str | None:
    """Returns what legs do, empty for a path that is not checked, None if somebody goes nowhere."""
    noun = _GAIT_NOUN.search(text)
    nouns = words_of(noun["noun"]) if noun else []
    # "Run with both hands raised" begins with a verb.
    nouns = [*words[:1], *nouns]
    gaits = [gait for gait, verbs in GAITS.items() if _places(words, verbs) or _places(nouns, verbs, also_nouns=True)]
    if _BACKWARD.search(text):
        return "backward"
    if not gaits and not _GOES.search(text):
        return None
    directions = {found["side"].lower() for found in _DIRECTION.finditer(_WITH.sub("", text))}
    if _OTHER_PATHS.search(text) or len(directions) > 1:
        return ""
    if directions:
        return directions.pop() if _TURNS.search(text) else ""
    return gaits[0] if gaits else "walk"
