"""Whether a sentence says that somebody moves slowly or fast: "walks at a gentle pace", "in a hurry", "dawdles"."""

import re
from typing import Literal, NamedTuple

from t2m_jax.text.verbs import NEGATION, bases_of, is_negated, word_set, words_of

_Speed = Literal["slow", "fast"]

_SLOW = (
    "slow|slowish|sluggish|leisurely|unhurried|lazy|relaxed|gentle|easy|low|crawling|snail's|drawn-out|languid|unrushed"
)
_FAST = (
    "fast|quick|rapid|swift|brisk|speedy|hasty|hurried|hectic|frantic|high|top|full|maximum|breakneck|furious|great|"
    "double|lightning"
)
_NOUNS = (
    "bow|claps?|crawl|dance|gait|gestures?|hops?|jabs?|jog|jumps?|kicks?|lunges?|motions?|movements?|pace|punch(?:es)?|rate|run|"
    "skips?|spins?|speed|sprint|squats?|steps?|strides?|stroll|strokes?|swings?|tempo|throws?|turns?|walk|waves?|"
    "fashion|manner|way|bowing|clapping|crawling|jogging|jumping|kicking|punching|running|turning|walking|waving"
)
"""What is slow or fast in "a slow wave", but not in "a slow train"."""
_MORE = r"(?:,| and|, and)? (?:big|calm|careful|easy|energetic|lazy|light|little|long|short|small|steady|tiny)"
_SPEEDS = "pace|rate|speed|tempo"
_ALONE = r"(?=$|[.,;!?]| (?:and|as if|as though|with|along|over|across|through|toward|towards|down|up|in|on|around)\b)"
"""What follows an adjective that is used as an adverb: "punches fast"."""


def _pattern(*parts: str) -> re.Pattern[str]:
    return re.compile("|".join(parts), re.IGNORECASE)


_PACES: dict[_Speed, re.Pattern[str]] = {
    "slow": _pattern(
        r"\b(?:slowly|unhurriedly|sluggishly|lazily|ponderously|languidly|leisurely)\b",
        rf"\b(?:slow|leisurely|sluggish|unhurried|drawn-out|languid|lazy)(?:{_MORE})? (?:{_NOUNS})\b",
        rf"\b(?:{_SLOW}) (?:{_SPEEDS})\b",
        rf"\bslow{_ALONE}",
        r"\bslow[- ]mo(?:tion)?\b",
        r"\bslow(?:ness|[- ](?:paced|moving))\b",
        r"\b(?:tak(?:e|es|ing)|took) (?:\w+ ){0,3}(?!(?:a|first|last|more|one|second|third) )\w+ time\b",
        r"\b(?:in|with) no (?:great |particular |real )?(?:hurry|rush|haste)\b",
        r"\bwithout (?:any |much |a )?(?:hurry\w*|rush\w*|haste)\b",
        r"\bno (?:hurry|rush)\b",
        r"\b(?:half|minimum|crawling|snail) speed\b",
        r"\b(?:like|as) an? (?:snail|tortoise|turtle|sloth)\b|\bsnail's\b",
        r"\btak(?:e|es|ing) it (?:easy|slow)\b",
        r"\bas slow(?:ly)? as\b",
    ),
    "fast": _pattern(
        r"\b(?:quickly|rapidly|swiftly|briskly|hastily|hurriedly|speedily|frantically|quick as|fast as)\b",
        rf"\b(?:fast|quick|rapid|swift|brisk|speedy|hasty|hurried|hectic|frantic)(?:{_MORE})? (?:{_NOUNS})\b",
        rf"\b(?:{_FAST}) (?:{_SPEEDS})\b",
        rf"(?<!hold )(?<!holds )(?<!held )(?<!stuck )(?<!his )(?<!her )(?<!their )\bfast{_ALONE}",
        rf"\b(?:real|really|so|super|very) quick{_ALONE}",
        r"\b(?:in|with) (?:such )?(?:an? )?(?:big |great |mad |real |tearing |terrible )?(?:hurry|rush|haste|flash)\b",
        r"\bat speed\b|\bfast[- ]paced\b",
        r"\blike (?:lightning|the wind|mad|crazy)\b",
        r"\bflat out\b",
        r"\bfor (?:his|her|its|their|your|my) (?:dear )?li(?:fe|ves)\b",
        r"\bas (?:if|though) [\w ]{0,30}\b(?:late|chased|hurry|hurried)\b",
        r"\bhurry up\b",
        r"\bpower[- ]walk",
    ),
}
_VERBS: dict[_Speed, frozenset[str]] = {
    "slow": word_set("amble dawdle inch lumber mosey plod saunter trudge"),
    "fast": word_set("bolt dash hasten hurry race rush scurry speed sprint"),
}
_CHANGES = _pattern(
    r"\b(?:slow|speed)(?:s|ed|ing)? (?:down|up|to)\b",
    r"\b(?:accelerat|decelerat)\w*",
    r"\b(?:faster|slower|quicker) and (?:faster|slower|quicker)\b",
    r"\b(?:getting|gets|becomes|becoming|ever) (?:faster|slower|quicker)\b",
    r"\b(?:slowly|quickly|fast|slow) at first\b",
)
"""The pace is not the same all the time."""
_OTHERS = _pattern(
    r"\b(?:while|when|where) (?:the|a|an|his|her|its|their|others?|everybody|everyone|people)\b.*",
    r"\bas (?:the|his|her|its|their|others?|everybody|everyone|people) .*",
    r"\b(?:who|which|that|whose)\b.*",
    r"\b(?:at|past|after|from|to|towards?|around|by|over|near|behind) (?:the|an?|some|his|her) (?:[\w-]+ ){1,3}\w+ing "
    r"(?:slowly|quickly|rapidly|fast|past|by)\b",
    r"\b(?:the|a|an|some|his|her) (?:slow|quick|rapid|fast|swift)(?:ly |-(?!paced))\w+(?:ing|ed)\b",
)
"""What is said of something else: "as the sun slowly sets", "a quickly spinning wheel"."""
_NEGATED = re.compile(rf"(?:{NEGATION}|\bless|n['\u2019]t)(?: [\w-]+){{0,3}} $", re.IGNORECASE)
GAITS = {
    "walk": word_set("amble dawdle march mosey plod saunter step stride stroll trudge walk"),
    "run": word_set("dash jog race run sprint"),
}
"""Verbs and nouns of gaits."""


class SaidPace(NamedTuple):
    """How fast somebody is asked to move."""

    is_slow: bool
    """Otherwise fast."""
    gait: str
    """`walk` or `run`; empty if the sentence says neither or both."""


def said_pace(caption: str) -> SaidPace | None:
    """Returns the pace that a sentence says; None if it says none, both, or that the pace changes.

    Paces of something else ("walks past slow traffic") and what is negated ("not too fast") are none.
    """
    if _CHANGES.search(caption):
        return None
    # In place of what is said of others, there is a comma, so that words before and after it are not read together.
    own = _OTHERS.sub(",", caption)
    is_slow = _is_said("slow", own)
    # "Without hurrying" has a verb for fast motion.
    is_fast = _is_said("fast", _PACES["slow"].sub(",", own))
    if is_slow == is_fast:
        return None
    gaits = [gait for gait, words in GAITS.items() if words & bases_of(words_of(own))]
    return SaidPace(is_slow, gaits[0] if len(gaits) == 1 else "")


def _is_said(speed: _Speed, text: str) -> bool:
    words = words_of(text)
    verbs = [index for index, word in enumerate(words) if word.action and word.bases & _VERBS[speed]]
    if not all(is_negated(words[:index]) for index in verbs):
        return True
    return any(not _NEGATED.search(text[: found.start()]) for found in _PACES[speed].finditer(text))
