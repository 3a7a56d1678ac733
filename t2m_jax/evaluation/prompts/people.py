"""Tests with sentences of people who described motion that they saw: captions of the KIT Motion-Language Dataset.

Nobody may pass the captions on with a package, so they are read from a file of the user: `annotations.json` of TMR
(https://github.com/Mathux/TMR), which has the name of the recorded motion beside each caption.
"""

import functools
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts.following import RULES, PromptTest, follows
from t2m_jax.files.reading import load_json

MAX_SENTENCES = 80
"""Sentences of an action; some actions have several hundred."""
MAX_BYTES = 2**28
# Words of a second action, of another way, or of a hand, which the rules of walking and running would not see.
OTHER = (
    "then|and|after|before|while|stop|stand|turn|circle|back|jump|hop|stumbl|push|curve|bend|corner|left|right|around|"
    "hand|arm|stair|up|down"
)
TURN_OTHER = "then|stop|back|jump|180|around|run|jog|spot|foot|circle"


class Described(NamedTuple):
    """Which captions describe an action: patterns of regular expressions."""

    motion: str
    """How the name of the recorded motion begins."""
    words: str
    """A caption has words like these."""
    other: str
    """A caption has no word that begins so."""


def _turn(side: str, other: str) -> Described:
    return Described(rf"(bend_{side}|{side.title()}Turn)\d", rf"\b{side}\b", rf"{other}|{TURN_OTHER}")


def _wave(motion: str, hands: str, other: str) -> Described:
    return Described(rf"wave_{motion}\d", rf"wav.*\b({hands})\b", rf"{other}|then|once|one|time")


DESCRIBED = {
    "walk": Described(
        r"(walking_(slow|medium|fast)|WalkingStraightForwards?)\d",
        r"\b(walk|go|step|stroll|march|mov|stride)",
        f"{OTHER}|run|jog|sprint",
    ),
    "run": Described(r"(walking_run|run)\d", r"\b(run|jog|sprint|dash|rac)", f"{OTHER}|walk"),
    "walk-turn-left": _turn("left", "right"),
    "walk-turn-right": _turn("right", "left"),
    "wave-left-hand": _wave("left", "left", "right|both"),
    "wave-right-hand": _wave("right", "right", "left|both"),
    "wave-both-hands": _wave("both", "both|hands|arms", "left|right"),
}


def kit_tests(path: Path) -> list[PromptTest]:
    """Returns tests of known actions with what people wrote about motion of this kind, at most 80 sentences each.

    Raises:
        UserError: The file is not one of TMR's annotations of KIT, or has no caption of these actions.
    """
    entries = load_json(path, max_bytes=MAX_BYTES)
    if not isinstance(entries, Mapping):
        raise UserError(f"{path}: is not a table of motions with captions (annotations.json of KIT in TMR)")
    found = {content: _sentences(path, entries, described) for content, described in DESCRIBED.items()}
    if not any(found.values()):
        raise UserError(f"{path}: has no caption of walking, running, turning or waving with a motion of KIT")
    return [
        PromptTest(content, RULES[content].words, _drawn(sentences), functools.partial(follows, content))
        for content, sentences in found.items()
        if sentences
    ]


def _sentences(path: Path, entries: Mapping[str, Any], described: Described) -> list[str]:
    """Returns the different captions of an action, in the order of the file."""
    other = re.compile(rf"\b({described.other})")
    found: dict[str, str] = {}
    for number, entry in entries.items():
        # Twins (M) have the same captions with sides exchanged.
        if number.startswith("M") or not re.match(described.motion, _motion_name(path, number, entry)):
            continue
        for text in _captions(path, number, entry):
            plain = text.lower().rstrip(". ")
            # A quarter of a circle is a corner.
            without_quarters = re.sub(r"quarter (of a )?circle", "", plain)
            if re.search(described.words, plain) and not other.search(without_quarters):
                found.setdefault(plain, text)
    return list(found.values())


def _motion_name(path: Path, number: str, entry: Any) -> str:
    try:
        return entry["path"].rpartition("/")[2]
    except (KeyError, TypeError, AttributeError):
        raise UserError(f"{path}: motion {number!r} has no `path`") from None


def _captions(path: Path, number: str, entry: Any) -> Iterator[str]:
    try:
        for annotation in entry["annotations"]:
            yield annotation["text"].strip()
    except (KeyError, TypeError, AttributeError):
        raise UserError(f"{path}: motion {number!r} has no list `annotations` of captions with `text`") from None


def _drawn(sentences: list[str]) -> tuple[str, ...]:
    """Returns at most `MAX_SENTENCES` of them, evenly over the file: neighbors are about the same motion."""
    places = np.linspace(0, len(sentences) - 1, min(len(sentences), MAX_SENTENCES)).round().astype(int)
    return tuple(sentences[place] for place in places)
