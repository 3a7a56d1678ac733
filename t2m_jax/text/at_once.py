"""What a sentence asks legs and arms to do at the same time: "walks backward while waving the left hand"."""

from collections.abc import Sequence
from typing import NamedTuple

from t2m_jax.text.numerals import pattern, without_others
from t2m_jax.text.paces import GAITS
from t2m_jax.text.sequence import split_sequence
from t2m_jax.text.verbs import SIDES, Word, is_negated, word_set, words_of

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
    own = without_others(caption)
    if _IN_TURN.search(own):
        return None
    words = words_of(own)
    arms = _arms(own, words)
    legs = _legs(own, words) if arms else None
    if not arms or legs is None or len(split_sequence(caption, _ACTIONS)) > 1:
        return None
    return SaidAtOnce(legs, arms, _hands(own) if arms in ("raise", "wave") else frozenset())


def _arms(text: str, words: Sequence[Word]) -> str:
    has_hand = _HAND.search(text) is not None
    for action, verbs in (("wave", _WAVES), ("clap", _CLAPS), ("punch", _PUNCHES)):
        if _does(words, verbs, also_nouns=has_hand or action != "wave"):
            return action
    is_raised = has_hand and (_UP.search(text) or _does(words, _RAISES, also_nouns=True))
    return "raise" if is_raised else ""


def _does(words: Sequence[Word], verbs: frozenset[str], *, also_nouns: bool = False) -> bool:
    """Returns whether somebody does what one of some verbs says, and whether a form of it is enough for that."""
    places = [place for place, word in enumerate(words) if word.bases & verbs and (word.action or also_nouns)]
    return bool(places) and not any(is_negated(words[:place]) for place in places)


def _hands(text: str) -> frozenset[str]:
    found = list(_HAND.finditer(text))
    sides = {side for one in found for side in (one["side"], one["other"]) if side}
    if not sides and (any(one["many"] for one in found) or _MANY.search(text)):
        return SIDES
    return frozenset(side.lower() for side in sides)


def _legs(text: str, words: Sequence[Word]) -> str | None:
    """Returns what legs do, empty for a path that is not checked, None if somebody goes nowhere."""
    noun = _GAIT_NOUN.search(text)
    nouns = words_of(noun["noun"]) if noun else []
    gaits = [gait for gait, verbs in GAITS.items() if _does(words, verbs) or _does(nouns, verbs, also_nouns=True)]
    if _BACKWARD.search(text):
        return "backward"
    if not gaits and not _GOES.search(text):
        return None
    directions = {found["side"].lower() for found in _DIRECTION.finditer(text)}
    if _OTHER_PATHS.search(text) or len(directions) > 1:
        return ""
    if directions:
        return directions.pop() if _TURNS.search(text) else ""
    return gaits[0] if gaits else "walk"
