"""Captions of labeled clips, composed from the labels and from measurements of the motion.

Every clip gets several different sentences. They depend only on the clip's name, labels and measurements, so an import
always gives the same folder. Some captions name the style and some do not, because people who ask for motion do both.
"""

import random
from collections.abc import Iterable
from typing import NamedTuple

from t2m_jax.data.captioning.grammar import Form, Manner, Subject, Wording, sentence
from t2m_jax.data.captioning.lexicon import tag_words
from t2m_jax.data.captioning.wordings import load_wordings
from t2m_jax.data.texts import Caption
from t2m_jax.motion.facts import Facts

FORMS: tuple[Form, ...] = ("present", "progressive", "imperative", "gerund", "begins")
FORM_WEIGHTS = (58, 18, 11, 9, 4)
STYLE_SHARE = 0.55
"""Share of the captions of a clip that name its style."""
SPEED_SHARE = 0.5
"""Share of the remaining captions of a clearly slow or fast clip that name its speed."""
STYLE_SUBJECT_SHARE = 0.3
"""Share of the captions whose subject fits the style, for styles that have such subjects."""
LOW_HANDS = 0.02
"""Meters above the shoulder that a wrist must reach before its hand counts as raised, not only lifted to shoulder
height."""
LOW_SHARE = 0.7
"""Share of the captions of a clip with low hands that mention it. The others name the style."""
CLAUSE_MARKS = (",", "while", "as if", "before")
"""Words that open a clause of their own: a manner at the end would be read as part of that clause."""


class Labels(NamedTuple):
    """What the name of a clip says."""

    content: str
    style: str


def clip_pace(labels: Labels, facts: Facts) -> str:
    """Returns "slow", "fast" or "", relative to other clips of the same content."""
    content = load_wordings().contents[labels.content]
    if facts.speed < content.slow_below:
        return "slow"
    return "fast" if facts.speed > content.fast_above else ""


def true_facts(labels: Labels, facts: Facts) -> frozenset[str]:
    """Returns the names of the facts that hold for a clip; wordings may need one of them."""
    pace = clip_pace(labels, facts)
    hands = {"left": (0,), "right": (1,), "both": (0, 1), "": ()}[load_wordings().contents[labels.content].side]
    low = bool(hands) and all(facts.above_shoulder[hand] < LOW_HANDS for hand in hands)
    found = {
        "": True,
        "not_fast": pace != "fast",
        "not_slow": pace != "slow",
        "overhead": bool(hands) and all(facts.above_head[hand] > 0 for hand in hands),
        "low": low,
        "not_low": not low,
        # People call turns of about 90 degrees so.
        "quarter": 65 <= abs(facts.turn) <= 115,
        "many": facts.waves >= 4,
    }
    return frozenset(name for name, holds in found.items() if holds)


def true_wordings(labels: Labels, facts: Facts) -> tuple[Wording, ...]:
    """Returns the wordings of a clip's content that may be said of it."""
    words = load_wordings()
    holding = true_facts(labels, facts)
    known = words.exceptions.get((labels.content, labels.style), words.contents[labels.content].wordings)
    return tuple(wording for wording in known if wording.needs in holding)


def compose(
    labels: Labels,
    wording: Wording,
    *,
    facts: Facts,
    style_share: float,
    generator: random.Random,
    manners: tuple[Manner, ...] = (),
) -> str:
    """Returns one sentence for a clip; subject, tense, manner and final stop are drawn at random.

    The order of the draws is part of the data set: another order gives other captions.

    Args:
        labels: Content and style of the clip.
        wording: What the sentence says.
        facts: Measurements of the clip.
        style_share: Share of the sentences that name the style.
        generator: Source of the draws.
        manners: One of these is named, instead of the style or the pace.
    """
    words = load_wordings()
    content = words.contents[labels.content]
    style = words.styles[labels.style]
    predicate = wording.predicate
    (form,) = generator.choices(FORMS, FORM_WEIGHTS)
    pace = clip_pace(labels, facts)
    if not manners and generator.random() < style_share:
        manners = style.manners
    elif not manners and pace and generator.random() < SPEED_SHARE:
        manners = content.paces[pace]
    # "walks while waving slowly" would say that the wave is slow.
    if any(mark in predicate for mark in CLAUSE_MARKS):
        manners = tuple(manner for manner in manners if manner.place != "end")
    # Not "walks at a steady pace at a slow pace".
    if "pace" in predicate:
        manners = tuple(manner for manner in manners if "pace" not in manner.text)
    manner = generator.choice(manners) if manners else None
    fits_style = style.subjects and generator.random() < STYLE_SUBJECT_SHARE
    subject = generator.choice(style.subjects if fits_style else words.subjects)
    if manner is not None and manner.place == "adjective":
        # The other forms have no subject, so there is no noun that an adjective could describe.
        form = form if form in ("present", "progressive", "begins") else "present"
        # "an old someone" is not English.
        subject = subject if len(subject.text.split()) == 2 else Subject("a person", "their")
    limb = generator.choice(("hand", "hand", "arm"))
    text = sentence(predicate, subject, form=form, side=content.side, limb=limb, manner=manner)
    # People write both.
    return text + generator.choice(("", "."))


def write_captions(name: str, labels: Labels, facts: Facts, *, count: int = 6) -> tuple[Caption, ...]:
    """Returns `count` different captions of a clip, the same for the same name, labels and facts.

    If the hands stay low, a caption mentions it or names the style that explains it. The bare "raises the left hand" is
    kept for hands that do go up, which is what people mean by it.

    Args:
        name: Name of the clip; seeds the choice.
        labels: Content and style; both must be known.
        facts: Measurements of the clip.
        count: Number of captions.
    """
    # Seeded by the name, so that a clip keeps its captions when others are added.
    generator = random.Random(f"captions of {name}")
    wordings = true_wordings(labels, facts)
    low = tuple(wording for wording in wordings if wording.needs == "low")
    styled = tuple(wording for wording in wordings if not any(mark in wording.predicate for mark in CLAUSE_MARKS))
    texts: dict[str, Wording] = {}
    while len(texts) < count:
        candidates = wordings
        style_share = STYLE_SHARE
        if low and generator.random() < LOW_SHARE:
            candidates = low
        elif low:
            candidates = styled
            style_share = 1.0
        wording = generator.choice(candidates)
        # The same wording again would say the same with another subject. With few wordings, it cannot be avoided.
        if len(wordings) > count and wording in texts.values():
            continue
        texts[compose(labels, wording, facts=facts, style_share=style_share, generator=generator)] = wording
    return tagged_captions(texts)


def tagged_captions(texts: Iterable[str]) -> tuple[Caption, ...]:
    """Returns captions with tokens; all their words must be in the vocabulary."""
    return tuple(Caption(text, tag_words(text, strict=True)) for text in texts)
