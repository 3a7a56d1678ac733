"""The contents of the Bandai-Namco data set (17 of dataset-1, 8 more of dataset-2), each with what people say of it."""

from typing import NamedTuple

from t2m_jax.data.importers.bandai_namco.action_wordings import (
    BOW,
    BYE,
    BYE_SHY,
    CALL,
    DANCE,
    GUIDE,
    GUIDE_BOTH,
    KICK,
    PUNCH,
    RESPOND,
    SLASH,
    SQUAT,
)
from t2m_jax.data.importers.bandai_namco.grammar import Side, Wording
from t2m_jax.data.importers.bandai_namco.hand_wordings import RAISE, RAISE_BOTH, RAISE_ONE, WAVE, WAVE_BOTH, WAVE_ONE
from t2m_jax.data.importers.bandai_namco.locomotion_wordings import BACK, DASH, RUN, SIDE, TURN, WALK


class Content(NamedTuple):
    """One content label: which side of the body it uses and its wordings."""

    side: Side
    wordings: tuple[Wording, ...]


CONTENTS: dict[str, Content] = {
    "walk": Content("", WALK),
    "run": Content("", RUN),
    "dash": Content("", DASH),
    "walk-back": Content("", BACK),
    "walk-left": Content("left", SIDE),
    "walk-right": Content("right", SIDE),
    "walk-turn-left": Content("left", TURN),
    "walk-turn-right": Content("right", TURN),
    "bow": Content("", BOW),
    "bye": Content("right", BYE),
    "byebye": Content("both", BYE),
    "guide": Content("right", GUIDE),
    "respond": Content("left", RESPOND),
    "call": Content("", CALL),
    "punch": Content("", PUNCH),
    "kick": Content("", KICK),
    "slash": Content("", SLASH),
    "dance-short": Content("", DANCE),
    "dance-long": Content("", DANCE),
    "raise-up-left-hand": Content("left", RAISE + RAISE_ONE),
    "raise-up-right-hand": Content("right", RAISE + RAISE_ONE),
    "raise-up-both-hands": Content("both", RAISE + RAISE_BOTH),
    "wave-left-hand": Content("left", WAVE + WAVE_ONE),
    "wave-right-hand": Content("right", WAVE + WAVE_ONE),
    "wave-both-hands": Content("both", WAVE + WAVE_BOTH),
    "squat": Content("", SQUAT),
}
"""Content label -> what is said of it; "squat" is of the procedural motions only."""

EXCEPTIONS: dict[tuple[str, str], tuple[Wording, ...]] = {
    ("bye", "not-confident"): BYE_SHY,
    ("guide", "happy"): GUIDE_BOTH,
}
"""(content, style) whose motion differs from what the content label says of all others."""
