"""The wordings of labeled actions and styles, read from the YAML files next to this module."""

import functools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from t2m_jax.data.captioning.grammar import Frame, Manner, Side, Subject, Wording, sentence
from t2m_jax.data.captioning.lexicon import read_words

FILES = ("actions", "body", "hands", "locomotion")
"""Files with the wordings of contents."""
PERSON = Subject("a person", "the")
PLAIN = Frame("{subject} {body}", "present")
POSSESSIVES = ("their", "his", "her", "its", "my", "your")


class Content(NamedTuple):
    """What people say of one content label."""

    side: Side
    """Side of the body that moves."""
    wordings: tuple[Wording, ...]
    slow_below: float
    """Speed (`Facts.speed`, meters per second) below which a clip is slow."""
    fast_above: float
    """Speed above which a clip is fast."""
    paces: Mapping[str, tuple[Manner, ...]]
    """Ways of saying "slow" and "fast"."""
    travels: bool
    """Whether the person goes somewhere."""
    like: str
    """Another content that is about the same; empty if there is none."""

    def plain_sentences(self) -> tuple[str, ...]:
        """Returns three sentences that say it in different words, the plainest first: "a person waves"."""
        usual = [one.predicate for one in self.wordings if not one.needs and one.nominal_form is None]
        spread = (usual[0], usual[len(usual) // 2], usual[-1])
        return tuple(sentence(PLAIN, predicate, PERSON, side=self.side) for predicate in spread)


class Style(NamedTuple):
    """How people put a style into words."""

    manners: tuple[Manner, ...]
    subjects: tuple[Subject, ...]
    """People who typically move in this style."""


class Wordings(NamedTuple):
    """Everything that captions say of actions."""

    contents: Mapping[str, Content]
    exceptions: Mapping[tuple[str, str], tuple[Wording, ...]]
    """(content, style) whose motion differs from what the content label says of all other styles."""
    styles: Mapping[str, Style]
    extremes: Mapping[str, tuple[Manner, ...]]
    """Ways of saying that a clip is among the slowest or the fastest of its content."""
    marks: Mapping[str, tuple[str, ...]]
    """Pace -> parts of a caption that call a motion slow or fast."""


class Frames(NamedTuple):
    """Everything in captions that does not change the motion."""

    by_form: Mapping[str, tuple[Frame, ...]]
    weights: Mapping[str, float]
    """How often the forms with verbs are drawn."""
    usual_subjects: tuple[Subject, ...]
    """What most people write."""
    other_subjects: tuple[Subject, ...]
    looks: tuple[str, ...]
    """What may follow a subject: "in a blue shirt"."""
    surroundings: Mapping[str, tuple[str, ...]]
    """Kind -> phrases that may follow an action."""
    nouns: tuple[str, ...]


def _subjects(pairs: Iterable[Sequence[str]]) -> tuple[Subject, ...]:
    """Returns subjects from pairs of a text and a possessive."""
    return tuple(Subject(text, possessive) for text, possessive in pairs)


def _pace_manners(entry: Mapping[str, Sequence[str]]) -> tuple[Manner, ...]:
    """Returns words for a pace at the end of a sentence, adverbs also before the verb, adjectives only before nouns."""
    # "slowly walks", but not "at a slow pace walks".
    before = [Manner(text, "before_verb") for text in entry["words"] if text.endswith("ly")]
    attributes = [Manner(text, "attribute") for text in entry["adjectives"]]
    return (*(Manner(text, "end") for text in entry["words"]), *before, *attributes)


@functools.cache
def load_wordings() -> Wordings:
    """Returns all wordings. The files are read once, when the first caption is written."""
    table = read_words(__package__, "contents")
    words = read_words(__package__, "styles")
    groups = {
        name: tuple(Wording(text, "" if fact == "always" else fact) for fact, texts in group.items() for text in texts)
        for file in FILES
        for name, group in read_words(__package__, file).items()
    }
    paces = {
        kind: {pace: _pace_manners(entry) for pace, entry in by_pace.items()}
        for kind, by_pace in words["paces"].items()
    }
    contents = {
        name: Content(
            entry.get("side", ""),
            tuple(wording for group in entry["wordings"] for wording in groups[group]),
            # Without limits, no clip of a content is called slow or fast.
            slow_below=entry.get("slow_below", -1.0),
            fast_above=entry.get("fast_above", float("inf")),
            paces=paces["stand" if entry.get("hands") else "travel"],
            travels=entry.get("travels", False),
            like=entry.get("like", ""),
        )
        for name, entry in table["contents"].items()
    }
    return Wordings(
        contents,
        exceptions={(entry["content"], entry["style"]): groups[entry["wordings"]] for entry in table["exceptions"]},
        styles={name: _style(entry) for name, entry in words["styles"].items()},
        extremes={name: _pace_manners(entry) for name, entry in words["extremes"].items()},
        marks={pace: tuple(texts) for pace, texts in words["marks"].items()},
    )


def _style(entry: Mapping[str, Any]) -> Style:
    # Phrases count twice, because people use them most.
    manners = [Manner(text, "end") for text in entry.get("phrases", ()) * 2]
    manners += [Manner(text, place) for text in entry.get("adverbs", ()) for place in ("end", "before_verb")]
    manners += [Manner(text, "adjective") for text in entry.get("adjectives", ())]
    return Style(tuple(manners), _subjects(entry.get("subjects", ())))


@functools.cache
def load_frames() -> Frames:
    """Returns frames, subjects, surroundings and nouns. The files are read once."""
    table = read_words(__package__, "frames")
    subjects = read_words(__package__, "subjects")
    return Frames(
        by_form={form: tuple(Frame(text, form) for text in entry["frames"]) for form, entry in table.items()},
        weights={form: entry["weight"] for form, entry in table.items() if "weight" in entry},
        usual_subjects=_subjects(subjects["usual"]),
        other_subjects=tuple(Subject(text, one) for one in POSSESSIVES for text in subjects[one]),
        looks=tuple(subjects["looks"]),
        surroundings={kind: tuple(texts) for kind, texts in read_words(__package__, "surroundings").items()},
        nouns=tuple(read_words(__package__, "nouns")["nouns"].split()),
    )
