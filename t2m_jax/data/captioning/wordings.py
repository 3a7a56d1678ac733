"""The wordings of labeled actions and styles, read from the YAML files next to this module."""

import functools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from t2m_jax.data.captioning.grammar import Manner, Side, Subject, Wording
from t2m_jax.data.captioning.lexicon import read_words


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


class Style(NamedTuple):
    """How people put a style into words."""

    manners: tuple[Manner, ...]
    subjects: tuple[Subject, ...]
    """People who typically move in this style."""


class Wordings(NamedTuple):
    """Everything that captions are made of."""

    contents: Mapping[str, Content]
    exceptions: Mapping[tuple[str, str], tuple[Wording, ...]]
    """(content, style) whose motion differs from what the content label says of all other styles."""
    styles: Mapping[str, Style]
    subjects: tuple[Subject, ...]
    """Subjects that say nothing about the style."""
    extremes: Mapping[str, tuple[Manner, ...]]
    """Ways of saying that a clip is among the slowest or the fastest of its content."""


def _subjects(pairs: Iterable[Sequence[str]]) -> tuple[Subject, ...]:
    """Returns subjects from pairs of a text and a possessive."""
    return tuple(Subject(text, possessive) for text, possessive in pairs)


def _pace_manners(texts: Sequence[str]) -> tuple[Manner, ...]:
    """Returns words for a pace at the end of a sentence, and adverbs also before the verb."""
    # "slowly walks", but not "at a slow pace walks".
    before = tuple(Manner(text, "before_verb") for text in texts if text.endswith("ly"))
    return tuple(Manner(text, "end") for text in texts) + before


@functools.cache
def load_wordings() -> Wordings:
    """Returns all wordings. The files are read once, when the first caption is written."""
    table = read_words(__package__, "contents")
    words = read_words(__package__, "styles")
    groups = {
        name: tuple(Wording(text, "" if fact == "always" else fact) for fact, texts in group.items() for text in texts)
        for file in ("actions", "hands", "locomotion")
        for name, group in read_words(__package__, file).items()
    }
    paces = {
        kind: {pace: _pace_manners(texts) for pace, texts in by_pace.items()}
        for kind, by_pace in words["paces"].items()
    }
    contents = {}
    for name, entry in table["contents"].items():
        wordings = tuple(wording for group in entry["wordings"] for wording in groups[group])
        side = entry.get("side", "")
        travels = side == "" or any("walk" in wording.predicate for wording in wordings)
        contents[name] = Content(
            side,
            wordings,
            # Without limits, no clip of a content is called slow or fast.
            slow_below=entry.get("slow_below", -1.0),
            fast_above=entry.get("fast_above", float("inf")),
            paces=paces["travel" if travels else "stand"],
        )
    return Wordings(
        contents,
        exceptions={(entry["content"], entry["style"]): groups[entry["wordings"]] for entry in table["exceptions"]},
        styles={name: _style(entry) for name, entry in words["styles"].items()},
        subjects=_subjects(words["subjects"]),
        extremes={name: _pace_manners(texts) for name, texts in words["extremes"].items()},
    )


def _style(entry: Mapping[str, Any]) -> Style:
    # Phrases count twice, because people use them most.
    manners = [Manner(text, "end") for text in entry.get("phrases", ()) * 2]
    manners += [Manner(text, place) for text in entry.get("adverbs", ()) for place in ("end", "before_verb")]
    manners += [Manner(text, "adjective") for text in entry.get("adjectives", ())]
    return Style(tuple(manners), _subjects(entry.get("subjects", ())))
