"""What is around an action in a sentence and does not change it: frame, subject, place, time, purpose."""

import random
from collections.abc import Sequence

from t2m_jax.data.captioning.grammar import ARTICLES, Frame, Subject
from t2m_jax.data.captioning.wordings import load_frames

FIRST_SHARE = 0.5
"""Share of the sentences with the first, shortest frame of a form."""
USUAL_SHARE = 0.5
"""Share of the subjects that most people write."""
NOUN_SHARE = 0.12
"""Share of the subjects, and of the sentences with surroundings, that are made of an open noun."""
LOOKS_SHARE = 0.1
"""Share of the subjects that are described."""
SURROUNDED_SHARE = 0.35
"""Share of the sentences that name a place, a time, a purpose or a goal."""
FRONT_SHARE = 0.15
"""Share of these that begin with it."""


def draw_frame(form: str | None, generator: random.Random) -> Frame:
    """Returns a frame of a form; without a form, of one of those with verbs."""
    frames = load_frames()
    if form is None:
        (form,) = generator.choices(tuple(frames.weights), tuple(frames.weights.values()))
    known = frames.by_form[form]
    return known[0] if generator.random() < FIRST_SHARE else generator.choice(known)


def draw_subject(fitting: Sequence[Subject], generator: random.Random, *, with_noun: bool = False) -> Subject:
    """Returns one of the fitting subjects; without any, one that says nothing of the motion.

    Args:
        fitting: People who typically move as the clip does.
        generator: Source of the draws.
        with_noun: Whether an adjective must have a noun that it can describe.
    """
    frames = load_frames()
    draw = generator.random()
    if fitting:
        subject = generator.choice(fitting)
    elif draw < NOUN_SHARE:
        subject = Subject(f"the {generator.choice(frames.nouns)}", "its")
    else:
        subject = generator.choice(frames.usual_subjects if draw < NOUN_SHARE + USUAL_SHARE else frames.other_subjects)
    has_article = subject.text.startswith(tuple(f"{article} " for article in ARTICLES))
    if with_noun and not has_article:
        return Subject("a person", "their")
    if has_article and generator.random() < LOOKS_SHARE:
        return subject._replace(text=f"{subject.text} {generator.choice(frames.looks)}")
    return subject


def around(text: str, frame: Frame, *, travels: bool, generator: random.Random) -> str:
    """Returns a sentence with a place, a time, a purpose or a goal, or unchanged.

    Args:
        text: The sentence.
        frame: Its frame.
        travels: Whether the person goes somewhere, so that there may be a goal.
        generator: Source of the draws.
    """
    if generator.random() >= SURROUNDED_SHARE:
        return text
    surroundings = load_frames().surroundings
    kinds = ["places", "places", "times", "purposes"] + ["goals"] * travels
    kind = generator.choice(kinds)
    phrase = generator.choice(surroundings[kind])
    if generator.random() < NOUN_SHARE * 2:
        near = surroundings["toward" if kind == "goals" else "near"]
        phrase = f"{generator.choice(near)} the {generator.choice(load_frames().nouns)}"
    if kind in ("places", "times") and frame.text.startswith("{subject}") and generator.random() < FRONT_SHARE:
        return f"{phrase}, {text}"
    # "is raised by a man in the park", but "can you run in the park?".
    ending = frame.text.partition("{body}")[2]
    ending = "" if "{" in ending else ending
    return f"{text.removesuffix(ending)} {phrase}{ending}"
