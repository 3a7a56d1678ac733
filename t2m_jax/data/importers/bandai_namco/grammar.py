"""Sentences from predicates: who does it, in which tense, how.

A predicate is text with the verbs in brackets, "[raise] {limb} and [lower] {it} again". Slots: `{poss}` his, her,
their, the or your; `{limb}` "his left hand", "both arms"; `{it}` it or them; `{side}` left or right.
"""

import re
from typing import Literal, NamedTuple

from t2m_jax.data.importers.lexicon import verb_forms

Form = Literal["present", "progressive", "imperative", "gerund", "begins"]
Side = Literal["left", "right", "both", ""]

_VERB = re.compile(r"\[(\w+)\]")


class Subject(NamedTuple):
    """Who moves, and the possessive that goes with it."""

    text: str
    possessive: str


class Manner(NamedTuple):
    """How something is done: words at the end, or (adverbs) before the verb, or an adjective of the subject."""

    text: str
    place: Literal["end", "before_verb", "adjective"]


def subject_with_adjective(subject: Subject, adjective: str) -> Subject:
    """Returns "an old man" for "a man" and "old"; subjects without a noun ("someone") stay as they are."""
    article, _, noun = subject.text.partition(" ")
    if not noun or article not in ("a", "an", "the"):
        return subject
    if article != "the":
        article = "an" if adjective[0] in "aeiou" else "a"
    return Subject(f"{article} {adjective} {noun}", subject.possessive)


def _fill(predicate: str, form: Form, *, possessive: str, side: Side, limb: str) -> str:
    """Returns the predicate with its slots filled and its verbs in the form that the sentence needs."""
    hands = f"both {limb}s" if side == "both" else f"{possessive} {side} {limb}"
    text = predicate.replace("{limb}", hands).replace("{poss}", possessive).replace("{side}", side)
    text = text.replace("{it}", "them" if side == "both" else "it")

    def verb(match: re.Match[str]) -> str:
        forms = verb_forms(match.group(1))
        if form == "present":
            return forms.third
        return forms.gerund if form in ("progressive", "gerund") else forms.base

    return _VERB.sub(verb, text)


def sentence(
    predicate: str, subject: Subject, *, form: Form, side: Side = "", limb: str = "hand", manner: Manner | None = None
) -> str:
    """Returns one sentence in lower case, without the final stop.

    Args:
        predicate: text with bracketed verbs and slots.
        subject: who; unused in the imperative and the bare gerund ("wave your left hand", "walking forward").
        form: tense or mood of all its verbs.
        side: fills `{side}` and `{limb}`.
        limb: "hand" or "arm".
        manner: how, or None.
    """
    if manner is not None and manner.place == "adjective":
        subject = subject_with_adjective(subject, manner.text)
    possessive = {"imperative": "your", "gerund": "the"}.get(form, subject.possessive)
    body = _fill(predicate, form, possessive=possessive, side=side, limb=limb)
    if manner is not None and manner.place == "before_verb":
        body = f"{manner.text} {body}"
    if manner is not None and manner.place == "end":
        body = f"{body} {manner.text}"
    opening = {"present": subject.text, "progressive": f"{subject.text} is", "begins": f"{subject.text} begins to"}
    return f"{opening[form]} {body}" if form in opening else body


class Wording(NamedTuple):
    """A predicate and the name of the fact that must hold for a clip before it may be said of it ("" for always)."""

    predicate: str
    needs: str = ""


def make_wordings(*predicates: str, **conditional: tuple[str, ...]) -> tuple[Wording, ...]:
    """Returns plain wordings, followed by those that need the fact they are filed under."""
    plain = tuple(Wording(text) for text in predicates)
    return plain + tuple(Wording(text, fact) for fact, texts in conditional.items() for text in texts)
