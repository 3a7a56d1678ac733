"""Captions of motion that is made of labeled pieces: in turn, at the same time, several times, or for some time."""

import functools
import random
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from t2m_jax.data.captioning.captions import (
    CLAUSE_MARKS,
    NORMAL,
    Labels,
    distinct_captions,
    says_pace,
    true_wordings,
    wordings_of,
)
from t2m_jax.data.captioning.frames import around, draw_frame, draw_subject
from t2m_jax.data.captioning.grammar import Form, Frame, Subject, Wording, clause
from t2m_jax.data.captioning.lexicon import read_words
from t2m_jax.data.captioning.wordings import load_frames, load_wordings
from t2m_jax.data.texts import Caption
from t2m_jax.motion.facts import Facts

MANNER_SHARE = 0.25
"""Share of the clauses that name the style."""
COUNTED_SHARE = 0.4
"""Share of the sentences that count a noun ("does three jumps"), for contents that have such wordings."""
PLAIN_FORMS = {
    "told": ("present", "present", "progressive", "past"),
    "plain": ("present", "present", "progressive", "past", "imperative"),
    "gerund": ("gerund",),
}
"""Group of patterns -> forms whose first frame they fit into. All others fit into any frame."""
PAUSES = {"stop": "[stop]", "halt": "[halt]", "still": "[stand] still", "come": "[come]"}
"""What is said between moving on and staying."""
NOBODY = {"imperative": Subject("you", "your"), "gerund": Subject("someone", "the")}


class Pattern(NamedTuple):
    """An order of clauses, and the group of frames that it fits into."""

    text: str
    group: str

    def draw_frame(self, generator: random.Random) -> Frame:
        """Returns a frame that it fits into."""
        if self.group not in PLAIN_FORMS:
            return draw_frame(None, generator)
        return load_frames().by_form[generator.choice(PLAIN_FORMS[self.group])][0]


def write_then_captions(
    pieces: Sequence[Labels], *, facts: Sequence[Facts], count: int, generator: random.Random
) -> tuple[Caption, ...]:
    """Returns `count` different captions of two or three actions in turn.

    Args:
        pieces: Labels of the pieces in the order in which they are shown.
        facts: Measurements of each piece.
        count: Number of captions.
        generator: Source of the draws.
    """
    patterns = _patterns("then_three" if len(pieces) == 3 else "then_two")
    if [load_wordings().contents[piece.content].travels for piece in pieces] == [True, False]:
        patterns += _patterns("then_stops")
    known = [_short(true_wordings(*piece)) for piece in zip(pieces, facts, strict=True)]
    # Low hands are always mentioned.
    known = [[one for one in wordings if one.needs == "low"] or wordings for wordings in known]
    draw = functools.partial(_say, patterns, pieces, known, generator)
    return distinct_captions(draw, count=count, generator=generator)


def write_while_captions(legs: Labels, arms: Labels, *, count: int, generator: random.Random) -> tuple[Caption, ...]:
    """Returns `count` different captions of one action of the legs and one of the arms at the same time."""
    known = [_always(legs, without="said_arms"), _always(arms, without="said_legs")]
    draw = functools.partial(_say, _patterns("while"), (legs, arms), known, generator)
    return distinct_captions(draw, count=count, generator=generator)


def write_count_captions(labels: Labels, times: int, *, count: int, generator: random.Random) -> tuple[Caption, ...]:
    """Returns `count` different captions of an action that is done `times` times, 1 or more."""
    table = read_words(__package__, "sequences")
    counted = [one for one in wordings_of(labels) if one.needs == "counted"] if times > 1 else []
    once = _always(labels, without="said_times")

    def draw() -> str:
        digits, number = _draw_number(times, generator)
        if counted and generator.random() < COUNTED_SHARE:
            known = [one._replace(predicate=one.predicate.replace("{number}", number)) for one in counted]
            return _say(_patterns("counted"), (labels,), [known], generator)
        words = generator.choice(table["times"].get(times, table["times"]["more"]))
        return _say(_patterns("count"), (labels,), [once], generator, times=words.format(digits=digits, number=number))

    return distinct_captions(draw, count=count, generator=generator)


def write_duration_captions(
    labels: Labels, seconds: float, *, count: int, generator: random.Random
) -> tuple[Caption, ...]:
    """Returns `count` different captions of an action that lasts so many seconds, which are rounded to halves."""
    table = read_words(__package__, "sequences")
    # "takes a few steps for five seconds" would say two lengths.
    lasting = _always(labels, without="said_lengths")

    def draw() -> str:
        digits, number = _draw_number(round(2 * seconds) / 2, generator)
        words = generator.choice(table["durations"]).format(digits=digits, number=number)
        words = words.replace("seconds", "second" if digits == "1" else "seconds")
        return _say(_patterns("duration"), (labels,), [lasting], generator, duration=words)

    return distinct_captions(draw, count=count, generator=generator)


def _always(labels: Labels, *, without: str) -> list[Wording]:
    """Returns the short wordings of a content that need no fact and have none of some marks."""
    marks = read_words(__package__, "sequences")[without]
    known = _short(one for one in wordings_of(labels) if not one.needs)
    return [one for one in known if not any(mark in one.predicate for mark in marks)]


def _short(wordings: Iterable[Wording]) -> list[Wording]:
    """Returns the wordings with verbs that have no clause of their own."""
    # "claps after the show" would say that it comes second.
    marks = (*CLAUSE_MARKS, " and then ", " after ")
    return [one for one in wordings if not one.nominal_form and not any(mark in one.predicate for mark in marks)]


def _draw_number(number: float, generator: random.Random) -> tuple[str, str]:
    """Returns a number in digits, and in words or digits."""
    words = read_words(__package__, "sequences")["numbers"]
    digits = f"{number:g}"
    return digits, generator.choice((digits, words[int(number)])) if number in range(len(words)) else digits


@functools.cache
def _patterns(kind: str) -> tuple[Pattern, ...]:
    table = read_words(__package__, "sequences")["patterns"][kind]
    return tuple(Pattern(text, group) for group, texts in table.items() for text in texts)


def _say(
    patterns: Sequence[Pattern],
    pieces: Sequence[Labels],
    known: Sequence[Sequence[Wording]],
    generator: random.Random,
    **slots: str,
) -> str:
    """Returns one sentence for pieces and what may be said of each; the order of the draws is part of the data set."""
    pattern = generator.choice(patterns)
    frame = pattern.draw_frame(generator)
    # Frames without a subject still need a possessive: "walk before raising your hand".
    subject = NOBODY.get(frame.form) or draw_subject((), generator)
    parts = [_draw_part(labels, wordings, generator) for labels, wordings in zip(pieces, known, strict=True)]
    limb = generator.choice(("hand", "hand", "arm"))
    forms: dict[str, Form] = {"": frame.form_for(subject), "ing": "progressive", "done": "perfect", "base": "base"}
    for name, form in forms.items():
        slots |= {f"{name}{place}": part(subject, form=form, limb=limb) for place, part in enumerate(parts)}
    slots |= {name: clause(text, subject, form=forms[""]) for name, text in PAUSES.items()}
    positional = [slots.pop(str(place)) for place in range(len(parts))]
    opening, again = (frame.opening(one) for one in (subject, subject.again()))
    text = pattern.text.format(*positional, **slots, subject=opening, again=again)
    travels = all(load_wordings().contents[labels.content].travels for labels in pieces)
    return around(text + frame.ending(subject), frame, travels=travels, generator=generator)


def _draw_part(labels: Labels, wordings: Sequence[Wording], generator: random.Random) -> Callable[..., str]:
    """Returns one of the wordings as a `clause`, sometimes with the style.

    It never has a pace: a style is not always slow.
    """
    manners = [one for one in load_wordings().styles[labels.style].manners if one.place == "end"]
    manners = [one for one in manners if not says_pace(one.text)]
    share = 0 if labels.style == NORMAL else MANNER_SHARE
    manner = generator.choice(manners) if manners and generator.random() < share else None
    side = load_wordings().contents[labels.content].side
    return functools.partial(clause, generator.choice(wordings).predicate, side=side, manner=manner)
