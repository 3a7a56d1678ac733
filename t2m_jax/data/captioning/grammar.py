"""Sentences from predicates.

A predicate is text with the verbs in brackets: "[raise] {limb} and [lower] {it} again". Its slots are `{poss}` (his,
her, their, the, your), `{limb}` ("his left hand", "both arms"), `{it}` (it, them) and `{side}` (left, right).
"""

import re
from typing import Literal, NamedTuple

from t2m_jax.data.captioning.lexicon import gerund, third_person

Form = Literal["present", "progressive", "imperative", "gerund", "begins"]
Side = Literal["left", "right", "both", ""]


class Subject(NamedTuple):
    """The person who moves, and the possessive that belongs to it."""

    text: str
    possessive: str


class Manner(NamedTuple):
    """How something is done, and the place of these words in the sentence."""

    text: str
    place: Literal["end", "before_verb", "adjective"]


class Wording(NamedTuple):
    """A predicate and the name of the fact that must hold for a clip before it may be used ("" for always)."""

    predicate: str
    needs: str = ""


def subject_with_adjective(subject: Subject, adjective: str) -> Subject:
    """Returns "an old man" for "a man" and "old". Subjects without a noun ("someone") are returned unchanged."""
    article, _, noun = subject.text.partition(" ")
    if not noun or article not in ("a", "an", "the"):
        return subject
    # The sound after the article is now that of the adjective.
    if article != "the":
        article = "an" if adjective[0] in "aeiou" else "a"
    return Subject(f"{article} {adjective} {noun}", subject.possessive)


def sentence(
    predicate: str, subject: Subject, *, form: Form, side: Side = "", limb: str = "hand", manner: Manner | None = None
) -> str:
    """Returns one sentence in lower case, without the final stop.

    Args:
        predicate: Text with verbs in brackets and slots in braces.
        subject: The person who moves. The imperative and the bare gerund ("walking forward") do not use it.
        form: Tense or mood of all verbs.
        side: Fills `{side}` and `{limb}`.
        limb: "hand" or "arm".
        manner: How it is done, or None.
    """
    if manner is not None and manner.place == "adjective":
        subject = subject_with_adjective(subject, manner.text)
    return opening(subject, form) + clause(predicate, subject, form=form, side=side, limb=limb, manner=manner)


def opening(subject: Subject, form: Form) -> str:
    """Returns what a sentence begins with, such as "a person is "; nothing in forms without a subject."""
    openings = {"present": f"{subject.text} ", "progressive": f"{subject.text} is "}
    return (openings | {"begins": f"{subject.text} begins to "}).get(form, "")


def clause(
    predicate: str, subject: Subject, *, form: Form, side: Side = "", limb: str = "hand", manner: Manner | None = None
) -> str:
    """Returns a sentence without its opening; arguments as for `sentence`. Adjectives are not in it."""
    text, place = manner or ("", "end")
    # These forms have no subject, but still need a possessive.
    possessive = {"imperative": "your", "gerund": "the"}.get(form, subject.possessive)
    hands = f"both {limb}s" if side == "both" else f"{possessive} {side} {limb}"
    body = predicate.replace("{limb}", hands).replace("{poss}", possessive).replace("{side}", side)
    body = body.replace("{it}", "them" if side == "both" else "it")
    inflect = {"present": third_person, "progressive": gerund, "gerund": gerund}.get(form, str)
    body = re.sub(r"\[(\w+)\]", lambda verb: inflect(verb[1]), body)
    if place == "before_verb":
        return f"{text} {body}"
    return f"{body} {text}" if place == "end" and text else body
