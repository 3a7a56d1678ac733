"""Captions of Bandai-Namco clips, composed from the labels and from what is measured in the motion.

Every clip gets several different sentences. Which ones depends on the clip's name alone, so an import gives the same
folder every time; style is said in some and left out in others, since people who ask for motion do both.
"""

import random
from collections.abc import Sequence
from typing import NamedTuple

from t2m_jax.data.importers.bandai_namco.contents import CONTENTS, EXCEPTIONS, Content
from t2m_jax.data.importers.bandai_namco.grammar import Form, Manner, Subject, Wording, sentence
from t2m_jax.data.importers.bandai_namco.measure import Facts
from t2m_jax.data.importers.bandai_namco.styles import STYLES, SUBJECTS, Style
from t2m_jax.data.importers.lexicon import tag_words
from t2m_jax.data.texts import Caption

FORMS: tuple[Form, ...] = ("present", "progressive", "imperative", "gerund", "begins")
FORM_WEIGHTS = (58, 18, 11, 9, 4)
STYLE_SHARE = 0.55
"""share of the captions of a styled clip that say its style"""
SPEED_SHARE = 0.5
"""share of the remaining captions of a clearly slow or fast clip that say so"""
_RAISE_LIMITS, _WAVE_LIMITS, _TURN_LIMITS = (1.0, 4.4), (0.85, 2.7), (0.95, 1.28)
SPEED_LIMITS: dict[str, tuple[float, float]] = {
    "walk": (1.0, 1.42),
    "run": (2.35, 3.15),
    "dash": (2.8, 3.9),
    "walk-back": (0.62, 1.05),
    "walk-left": (0.65, 1.2),
    "walk-right": (0.65, 1.2),
    "walk-turn-left": _TURN_LIMITS,
    "walk-turn-right": _TURN_LIMITS,
    "raise-up-left-hand": _RAISE_LIMITS,
    "raise-up-right-hand": _RAISE_LIMITS,
    "raise-up-both-hands": _RAISE_LIMITS,
    "wave-left-hand": _WAVE_LIMITS,
    "wave-right-hand": _WAVE_LIMITS,
    "wave-both-hands": _WAVE_LIMITS,
}
"""content -> metres a second (`Facts.speed`) below which a clip is slow and above which it is fast: about the
slowest and the fastest fifth of the training clips"""
LOW_HANDS = 0.02
"""metres above the shoulder that a wrist must reach before its hand counts as raised rather than lifted to shoulder
height"""
LOW_SHARE = 0.7
"""share of the captions of a clip with low hands which say that they stay low; the others say the style"""
_SPEED_WORDS = {
    "slow": ("slowly", "at a slow pace", "with slow movements", "unhurriedly"),
    "fast": ("quickly", "fast", "rapidly", "at a quick pace", "swiftly"),
}
_STANDING_SPEED_WORDS = {"slow": ("slowly", "gently"), "fast": ("quickly", "rapidly", "swiftly", "fast")}


_UNSTYLED = (",", "while", "as if", "before")
"""words that open a clause of their own: what stands behind it would be read as part of it"""


class Labels(NamedTuple):
    """What the name of a clip says."""

    content: str
    style: str


def clip_pace(labels: Labels, facts: Facts) -> str:
    """Returns "slow", "fast" or "", relative to other clips of the same content."""
    slow, fast = SPEED_LIMITS.get(labels.content, (-1.0, float("inf")))
    if facts.speed < slow:
        return "slow"
    return "fast" if facts.speed > fast else ""


def true_facts(labels: Labels, facts: Facts) -> frozenset[str]:
    """Returns the names under which wordings may ask for facts that hold for this clip."""
    pace = clip_pace(labels, facts)
    hands = {"left": (0,), "right": (1,), "both": (0, 1), "": ()}[CONTENTS[labels.content].side]
    above = bool(hands) and all(facts.above_head[hand] > 0 for hand in hands)
    low = bool(hands) and all(facts.above_shoulder[hand] < LOW_HANDS for hand in hands)
    found = {
        "": True,
        "not_fast": pace != "fast",
        "not_slow": pace != "slow",
        "overhead": above,
        "low": low,
        "not_low": not low,
    }
    found |= {"quarter": 65 <= abs(facts.turn) <= 115, "many": facts.waves >= 4}
    return frozenset(name for name, holds in found.items() if holds)


def _style_manners(style: Style) -> list[Manner]:
    """Returns the ways of saying a style; phrases count twice, as people use them most."""
    manners = [Manner(text, "end") for text in style.phrases * 2]
    manners += [Manner(text, place) for text in style.adverbs for place in ("end", "before_verb")]
    return manners + [Manner(text, "adjective") for text in style.adjectives]


def _pace_manners(content: Content, pace: str) -> list[Manner]:
    """Returns the ways of saying "slow" or "fast" of someone who goes somewhere, or who stands and moves the hands."""
    goes = content.side == "" or any("walk" in wording.predicate for wording in content.wordings)
    words = (_SPEED_WORDS if goes else _STANDING_SPEED_WORDS)[pace]
    return [Manner(text, "end") for text in words] + [
        Manner(text, "before_verb") for text in words if text.endswith("ly")
    ]


def _fits(manner: Manner, predicate: str) -> bool:
    """Returns whether the manner can stand in the sentence: not behind a clause of its own, no "pace" twice."""
    behind_clause = manner.place == "end" and any(mark in predicate for mark in _UNSTYLED)
    return not behind_clause and not ("pace" in manner.text and "pace" in predicate)


def _manner(
    labels: Labels, pace: str, predicate: str, *, style_share: float, generator: random.Random
) -> Manner | None:
    """Returns how to say the style or the speed of a clip in one of its captions, or None to leave both out."""
    manners: list[Manner] = []
    if generator.random() < style_share:
        manners = _style_manners(STYLES[labels.style])
    elif pace and generator.random() < SPEED_SHARE:
        manners = _pace_manners(CONTENTS[labels.content], pace)
    manners = [manner for manner in manners if _fits(manner, predicate)]
    return generator.choice(manners) if manners else None


def _subject(style: Style, generator: random.Random) -> Subject:
    """Returns who moves: mostly a neutral subject, sometimes one that fits the style."""
    if style.subjects and generator.random() < 0.3:
        return generator.choice(style.subjects)
    return generator.choice(SUBJECTS)


def compose(labels: Labels, wording: Wording, *, facts: Facts, style_share: float, generator: random.Random) -> str:
    """Returns one sentence for a clip from one wording, with subject, tense, manner and final stop drawn at random."""
    (form,) = generator.choices(FORMS, FORM_WEIGHTS)
    pace = clip_pace(labels, facts)
    manner = _manner(labels, pace, wording.predicate, style_share=style_share, generator=generator)
    subject = _subject(STYLES[labels.style], generator)
    if manner is not None and manner.place == "adjective":
        form = form if form in ("present", "progressive", "begins") else "present"
        subject = subject if len(subject.text.split()) == 2 else Subject("a person", "their")
    limb = generator.choice(("hand", "hand", "arm"))
    side = CONTENTS[labels.content].side
    text = sentence(wording.predicate, subject, form=form, side=side, limb=limb, manner=manner)
    return text + generator.choice(("", "."))


def _draw_wording(wordings: Sequence[Wording], generator: random.Random) -> tuple[Wording, float]:
    """Returns a wording and how often its caption should say the style.

    Hands that stay low are said to stay low, or the style that explains it is said: the bare "raises the left hand"
    is kept for hands that do go up, which is what people mean by it.
    """
    low = [wording for wording in wordings if wording.needs == "low"]
    if not low:
        return generator.choice(wordings), STYLE_SHARE
    if generator.random() < LOW_SHARE:
        return generator.choice(low), STYLE_SHARE
    return generator.choice(
        [wording for wording in wordings if not any(sign in wording.predicate for sign in _UNSTYLED)]
    ), 1.0


def write_captions(name: str, labels: Labels, facts: Facts, *, count: int = 6) -> tuple[Caption, ...]:
    """Returns `count` different captions of a clip, the same for the same name, labels and facts.

    Args:
        name: the clip; seeds the choice.
        labels: its content and style; both must be known.
        facts: what was measured in it.
        count: how many.
    """
    generator = random.Random(f"captions of {name}")
    wordings = EXCEPTIONS.get((labels.content, labels.style), CONTENTS[labels.content].wordings)
    holding = true_facts(labels, facts)
    wordings = tuple(wording for wording in wordings if wording.needs in holding)
    texts: dict[str, Wording] = {}
    while len(texts) < count:
        wording, style_share = _draw_wording(wordings, generator)
        if len(wordings) > count and wording in texts.values():
            continue
        texts[compose(labels, wording, facts=facts, style_share=style_share, generator=generator)] = wording
    return tuple(Caption(text, tag_words(text, strict=True)) for text in texts)
