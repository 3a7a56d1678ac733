"""The wordings of the Bandai-Namco captions, read from the YAML files beside this module."""

import functools
import importlib.resources
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import yaml

from t2m_jax.data.captioning.grammar import Manner, Side, Subject, Wording


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


class Pace(NamedTuple):
    """How fast somebody is asked to move. One of the limits is None."""

    name: str
    phrases: tuple[str, ...]
    """What is added to a sentence."""
    slower_than: float | None
    """Share of an action's clips, the slowest ones."""
    faster_than: float | None
    """Share of an action's clips, all but the fastest ones."""


class ComposedRequest(NamedTuple):
    """Sentences that ask for two contents, one after the other."""

    parts: tuple[str, str]
    sentences: tuple[str, ...]


class Composition(NamedTuple):
    """How several contents follow each other, and how people say it."""

    weights: Mapping[str, float]
    """Content -> how often it is drawn."""
    two: tuple[str, ...]
    """Sentences of two clauses."""
    stops: tuple[str, ...]
    """Sentences of somebody who goes somewhere and then stops."""
    three: tuple[str, ...]
    """Sentences of three clauses."""


class Wordings(NamedTuple):
    """Everything that captions are made of."""

    contents: Mapping[str, Content]
    exceptions: Mapping[tuple[str, str], tuple[Wording, ...]]
    """(content, style) whose motion differs from what the content label says of all other styles."""
    styles: Mapping[str, Style]
    subjects: tuple[Subject, ...]
    """Subjects that say nothing about the style."""


def _read(name: str) -> Any:
    """Returns the data of a YAML file beside this module."""
    file = importlib.resources.files(__package__) / f"{name}.yaml"
    return yaml.safe_load(file.read_text(encoding="utf-8"))


def _subjects(pairs: Iterable[Sequence[str]]) -> tuple[Subject, ...]:
    """Returns subjects from pairs of a text and a possessive."""
    return tuple(Subject(text, possessive) for text, possessive in pairs)


def _pace_manners(texts: Sequence[str]) -> tuple[Manner, ...]:
    """Returns words for a pace at the end of a sentence, and adverbs also before the verb."""
    before = tuple(Manner(text, "before_verb") for text in texts if text.endswith("ly"))
    return tuple(Manner(text, "end") for text in texts) + before


@functools.cache
def load_wordings() -> Wordings:
    """Returns all wordings. The files are read once, when the first caption is written."""
    table, words = _read("contents"), _read("styles")
    groups = {
        name: tuple(Wording(text, "" if fact == "always" else fact) for fact, texts in group.items() for text in texts)
        for file in ("actions", "hands", "locomotion")
        for name, group in _read(file).items()
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
        limits = entry.get("slow_below", -1.0), entry.get("fast_above", float("inf"))
        contents[name] = Content(side, wordings, *limits, paces["travel" if travels else "stand"])
    exceptions = {(entry["content"], entry["style"]): groups[entry["wordings"]] for entry in table["exceptions"]}
    styles = {}
    for name, entry in words["styles"].items():
        # Phrases count twice, because people use them most.
        manners = [Manner(text, "end") for text in entry.get("phrases", ()) * 2]
        manners += [Manner(text, place) for text in entry.get("adverbs", ()) for place in ("end", "before_verb")]
        manners += [Manner(text, "adjective") for text in entry.get("adjectives", ())]
        styles[name] = Style(tuple(manners), _subjects(entry.get("subjects", ())))
    return Wordings(contents, exceptions, styles, _subjects(words["subjects"]))


@functools.cache
def load_composition() -> Composition:
    """Returns how several contents follow each other."""
    entries = _read("composed")
    return Composition(entries["weights"], *(tuple(entries[name]) for name in ("two", "stops", "three")))


@functools.cache
def load_extremes() -> Mapping[str, tuple[Manner, ...]]:
    """Returns the ways of saying that a clip is among the slowest or the fastest of its content."""
    return {name: _pace_manners(texts) for name, texts in _read("styles")["extremes"].items()}


@functools.cache
def held_out_sentences() -> Mapping[str, tuple[str, ...]]:
    """Returns content of dataset-2 -> sentences that no training caption equals."""
    return {
        content: tuple(sentence.format(side=side) for sentence in group["sentences"])
        for group in _read("held_out")
        for content, side in group["contents"].items()
    }


@functools.cache
def held_out_paces() -> tuple[Pace, ...]:
    """Returns the paces that held-out sentences are combined with."""
    return tuple(
        Pace(entry["name"], tuple(entry["phrases"]), entry.get("slower_than"), entry.get("faster_than"))
        for entry in _read("held_out_paces")
    )


@functools.cache
def held_out_compositions() -> tuple[ComposedRequest, ...]:
    """Returns sentences that ask for two contents of dataset-2, one after the other; no training caption does."""
    return tuple(
        ComposedRequest(tuple(entry["parts"]), tuple(entry["sentences"])) for entry in _read("held_out_composed")
    )
