"""Captions of labeled clips, composed from the labels and from measurements of the motion.

Every clip gets several different sentences. They depend only on the clip's name, labels and measurements, so an import
always gives the same folder. Some captions name the style and some do not, because people who ask for motion do both.
Most of what else they say, such as who moves and where, has nothing to do with the motion.
"""

import random
from collections.abc import Callable, Iterable
from typing import NamedTuple

from t2m_jax.data.captioning.frames import around, draw_frame, draw_subject
from t2m_jax.data.captioning.grammar import Frame, Manner, Subject, Wording, sentence
from t2m_jax.data.captioning.held_out import fingerprint, held_out_fingerprints
from t2m_jax.data.captioning.lexicon import tag_words
from t2m_jax.data.captioning.typing_habits import as_typed
from t2m_jax.data.captioning.wordings import load_wordings
from t2m_jax.data.texts import Caption
from t2m_jax.motion.facts import Facts

CAPTIONS = 24
"""Captions of a clip. With fewer, a model that is trained for long learns their subjects and places by heart."""
STYLE_SHARE = 0.55
"""Share of the captions of a clip that name its style."""
NORMAL = "normal"
NORMAL_SHARE = 0.15
"""The same for clips in a normal style, which few people mention."""
SPEED_SHARE = 0.5
"""Share of the remaining captions of a clearly slow or fast clip that name its speed."""
STYLE_SUBJECT_SHARE = 0.3
"""Share of the captions whose subject fits the style, for styles that have such subjects."""
NUM_USUAL = 8
"""Wordings of a content that most people use. They are the first in its file."""
USUAL_SHARE = 0.25
"""Share of the captions that have one of these in any case."""
PLAIN_SHARE = 0.1
"""Share of the captions that say what somebody does and nothing else, as people write first of all."""
PLAIN_SUBJECTS = (
    *[Subject(text, "their") for text in ("a person", "a person", "a person", "the person", "someone")],
    Subject("a man", "his"),
    Subject("a woman", "her"),
)
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
    holding = true_facts(labels, facts)
    return tuple(wording for wording in wordings_of(labels) if wording.needs in holding)


def wordings_of(labels: Labels) -> tuple[Wording, ...]:
    """Returns all wordings of a clip's content, whatever they need."""
    words = load_wordings()
    return words.exceptions.get((labels.content, labels.style), words.contents[labels.content].wordings)


def says_pace(text: str, *paces: str) -> bool:
    """Returns whether a part of a caption says how fast already. By default, all paces are searched."""
    marks = load_wordings().marks
    # Marks are beginnings of words: "breakfast" is not fast.
    text = " " + text.replace("[", "")
    return any(f" {mark}" in text for pace in paces or marks for mark in marks[pace])


def compose(
    labels: Labels,
    wording: Wording,
    *,
    facts: Facts,
    style_share: float,
    generator: random.Random,
    manners: tuple[Manner, ...] = (),
) -> str:
    """Returns one sentence for a clip; frame, subject, manner and surroundings are drawn at random.

    The order of the draws is part of the data set: another order gives other captions.

    Args:
        labels: Content and style of the clip.
        wording: What the sentence says.
        facts: Measurements of the clip.
        style_share: Share of the sentences that name the style.
        generator: Source of the draws.
        manners: One of these is named, instead of the style or the pace.
    """
    content = load_wordings().contents[labels.content]
    style = load_wordings().styles[labels.style]
    frame = draw_frame(wording.nominal_form, generator)
    pace = clip_pace(labels, facts)
    if not manners and generator.random() < style_share:
        manners = style.manners
    elif not manners and pace and generator.random() < SPEED_SHARE:
        manners = content.paces[pace]
    manner = _draw_manner(manners, wording, generator)
    described = manner is not None and manner.place == "adjective"
    if described and frame.form != "noun":
        frame = draw_frame("present", generator)
    # Not "a sad sad man".
    fitting = style.subjects if generator.random() < STYLE_SUBJECT_SHARE and not described else ()
    subject = draw_subject(fitting, generator, with_noun=described)
    limb = generator.choice(("hand", "hand", "arm"))
    text = sentence(frame, wording.predicate, subject, side=content.side, limb=limb, manner=manner)
    return around(text, frame, travels=content.travels, generator=generator)


def compose_plainly(labels: Labels, wording: Wording, generator: random.Random) -> str:
    """Returns a short sentence for a clip: somebody and a wording that has a verb, without anything around it."""
    content = load_wordings().contents[labels.content]
    subject = generator.choice(PLAIN_SUBJECTS)
    limb = generator.choice(("hand", "arm"))
    return sentence(Frame("{subject} {body}", "present"), wording.predicate, subject, side=content.side, limb=limb)


def _draw_manner(manners: Iterable[Manner], wording: Wording, generator: random.Random) -> Manner | None:
    """Returns one of the manners that fit to a wording, or None."""
    places = {"end", "before_verb", "adjective"}
    if wording.nominal_form:
        places = {"adjective", "attribute"} if wording.nominal_form == "noun" else {"end"}
    # "walks while waving slowly" would say that the wave is slow.
    if any(mark in wording.predicate for mark in CLAUSE_MARKS):
        places -= {"end"}
    fitting = [manner for manner in manners if manner.place in places]
    # Not "walks at a steady pace at a slow pace".
    if says_pace(wording.predicate):
        fitting = [manner for manner in fitting if not says_pace(manner.text)]
    return generator.choice(fitting) if fitting else None


def write_captions(name: str, labels: Labels, facts: Facts, *, count: int = CAPTIONS) -> tuple[Caption, ...]:
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
    styled = tuple(one for one in wordings if not any(mark in one.predicate for mark in CLAUSE_MARKS))
    styled = tuple(one for one in styled if one.nominal_form is None)
    used: list[Wording] = []

    def draw() -> str:
        candidates = wordings
        style_share = NORMAL_SHARE if labels.style == NORMAL else STYLE_SHARE
        if low and (labels.style == NORMAL or generator.random() < LOW_SHARE):
            candidates = low
        elif low:
            candidates = styled
            style_share = 1.0
        # The same wording again would say the same with another subject. With few wordings, it cannot be avoided.
        fresh = [wording for wording in candidates if wording not in used] or candidates
        verbal = [wording for wording in candidates[:NUM_USUAL] if wording.nominal_form is None]
        if verbal and style_share < 1 and generator.random() < PLAIN_SHARE:
            return compose_plainly(labels, generator.choice(verbal), generator)
        usual = generator.random() < USUAL_SHARE
        used.append(generator.choice(candidates[:NUM_USUAL] if usual else fresh))
        return compose(labels, used[-1], facts=facts, style_share=style_share, generator=generator)

    return distinct_captions(draw, count=count, generator=generator)


def distinct_captions(draw: Callable[[], str], *, count: int, generator: random.Random) -> tuple[Caption, ...]:
    """Returns captions of `count` different sentences that `draw` gives; none of them is a test sentence."""
    texts: dict[str, None] = {}
    while len(texts) < count:
        text = draw()
        if fingerprint(text) not in held_out_fingerprints():
            texts[text] = None
    return tagged_captions(texts, generator)


def tagged_captions(texts: Iterable[str], generator: random.Random) -> tuple[Caption, ...]:
    """Returns captions as people type them, each once. Their tokens have no typing mistakes."""
    return tuple(Caption(as_typed(text, generator), tag_words(text)) for text in dict.fromkeys(texts))
