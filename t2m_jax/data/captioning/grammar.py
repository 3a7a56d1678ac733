"""Sentences from predicates and frames.

A predicate is text with the verbs in brackets: "[raise] {limb} and [lower] {it} again". Its slots are `{poss}` (his,
her, their, the, your), `{limb}` ("his left hand", "both arms"), `{it}` (it, them), `{side}` (left, right) and `{be}`
(is, are). Without verbs, it is a noun phrase ("a walk forward") or, with `{be}`, a passive ("{limb} {be} raised").

A frame is the sentence around it: "make {object} {body}".
"""

import re
from typing import Literal, NamedTuple

from t2m_jax.data.captioning.lexicon import inflect

Form = Literal["present", "progressive", "base", "past", "perfect", "imperative", "gerund", "noun", "passive"]
Side = Literal["left", "right", "both", ""]
INFLECTIONS = {"present": "VBZ", "progressive": "VBG", "gerund": "VBG", "past": "VBD", "perfect": "VBN"}
"""Penn Treebank tags of the verbs of forms; in the other ones, they are in their basic form."""
POSSESSIVES = {"imperative": "your", "gerund": "the", "noun": "the", "passive": "the"}
"""Possessives of the forms that have no subject."""
OBJECTS = {"he": "him", "she": "her", "they": "them", "I": "me"}
SINGULAR = {"be": "is", "was": "was", "has": "has", "does": "does"}
PLURAL = {"be": "are", "was": "were", "has": "have", "does": "do"}
AUXILIARIES = {"I": PLURAL | {"be": "am", "was": "was"}, "they": PLURAL, "you": PLURAL}
"""Subjects whose verbs have another form than those of "he"."""
PRONOUNS = {"his": "he", "her": "she", "its": "it"}
ARTICLES = ("a", "an", "the", "my", "our", "your", "this", "that", "some")


class Subject(NamedTuple):
    """The person who moves, and the possessive that belongs to it."""

    text: str
    possessive: str

    def again(self) -> "Subject":
        """Returns what the same person is called in the next clause: "he", or "the guard" after "a guard"."""
        if self.possessive in PRONOUNS:
            return Subject(PRONOUNS[self.possessive], self.possessive)
        article, _, noun = self.text.partition(" ")
        return self._replace(text=f"the {noun}") if article in ("a", "an") else self

    def indefinite(self) -> str:
        """Returns who may follow "there is": "a guard" for "the guard", and "someone" for a name."""
        article, _, noun = self.text.partition(" ")
        if article in ("a", "an", "someone", "somebody"):
            return self.text
        if article != "the" or not noun:
            return "someone"
        return f"an {noun}" if noun[0] in "aeiou" else f"a {noun}"


class Manner(NamedTuple):
    """How something is done, and the place of these words in the sentence."""

    text: str
    place: Literal["end", "before_verb", "adjective", "attribute"]
    """An adjective describes the person, or the noun of a noun phrase; an attribute only the latter."""


class Wording(NamedTuple):
    """A predicate and the name of the fact that must hold for a clip before it may be used ("" for always)."""

    predicate: str
    needs: str = ""

    @property
    def nominal_form(self) -> Form | None:
        """What it is if it has no verb: a noun phrase or a passive."""
        if "[" in self.predicate:
            return None
        return "passive" if "{be}" in self.predicate else "noun"


class Frame(NamedTuple):
    """A sentence around a clause, and the form of the verbs in it."""

    text: str
    form: Form

    def form_for(self, subject: Subject) -> Form:
        """Returns the form of the verbs after a subject: "they walk"."""
        return "base" if self.form == "present" and subject.text in AUXILIARIES else self.form

    def opening(self, subject: Subject) -> str:
        """Returns what the sentence begins with, such as "a person is "."""
        return self._fill(0, subject)

    def _fill(self, part: int, subject: Subject) -> str:
        text = self.text.partition("{body}")[part]
        words = AUXILIARIES.get(subject.text, SINGULAR)
        known = {"subject": subject.text, "object": OBJECTS.get(subject.text, subject.text)}
        return text.format(**known, indefinite=subject.indefinite(), **words)

    def ending(self, subject: Subject) -> str:
        """Returns what follows the clause, such as " by a person"."""
        return self._fill(2, subject)


def with_adjective(text: str, adjective: str) -> str:
    """Returns "an old man" for "a man" and "old". Texts without an article ("someone") are returned unchanged."""
    article, _, noun = text.partition(" ")
    if not noun or article not in ARTICLES:
        return text
    # The sound after the article is now that of the adjective.
    if article in ("a", "an"):
        article = "an" if adjective[0] in "aeiou" else "a"
    return f"{article} {adjective} {noun}"


def clause(
    predicate: str, subject: Subject, *, form: Form, side: Side = "", limb: str = "hand", manner: Manner | None = None
) -> str:
    """Returns a sentence without its frame, in lower case.

    Args:
        predicate: Text with verbs in brackets and slots in braces.
        subject: The person who moves. Some forms do not use it ("walking forward").
        form: Tense or mood of all verbs.
        side: Fills `{side}` and `{limb}`.
        limb: "hand" or "arm".
        manner: How it is done, or None. An adjective is only used in a noun phrase.
    """
    text, place = manner or ("", "end")
    if place in ("end", "before_verb"):
        predicate = f"{predicate} {text}".rstrip() if place == "end" else f"{text} {predicate}"
    # These forms have no subject, but still need a possessive.
    possessive = POSSESSIVES.get(form, subject.possessive)
    hands = f"both {limb}s" if side == "both" else f"{possessive} {side} {limb}"
    body = predicate.replace("{limb}", hands).replace("{poss}", possessive).replace("{side}", side)
    body = body.replace("{it}", "them" if side == "both" else "it").replace("{be}", "are" if side == "both" else "is")
    tag = INFLECTIONS.get(form)
    body = re.sub(r"\[(\w+)\]", lambda verb: inflect(verb[1], tag) if tag else verb[1], body)
    return with_adjective(body, text) if form == "noun" and place != "end" else body


def sentence(
    frame: Frame, predicate: str, subject: Subject, *, side: Side = "", limb: str = "hand", manner: Manner | None = None
) -> str:
    """Returns one sentence without a final stop; arguments as for `clause`."""
    body = clause(predicate, subject, form=frame.form_for(subject), side=side, limb=limb, manner=manner)
    # In a noun phrase, the clause has the adjective.
    if manner is not None and manner.place == "adjective" and frame.form != "noun":
        subject = subject._replace(text=with_adjective(subject.text, manner.text))
    return frame.opening(subject) + body + frame.ending(subject)
