"""Lessons of `t2m teach`: new sentences, each with one that the model understands and that asks for the same motion."""

import logging
import random
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from t2m_jax.data.captioning.grammar import Subject, clause
from t2m_jax.data.captioning.lexicon import read_words
from t2m_jax.data.captioning.typing_habits import as_typed, with_typo
from t2m_jax.data.captioning.wordings import load_wordings
from t2m_jax.data.folder import Dataset
from t2m_jax.errors import UserError, naming
from t2m_jax.motion.mirroring import mirror_caption
from t2m_jax.text.coverage import DIRECTIONS, NUMBERS, Knowledge, check_coverage, make_knowledge
from t2m_jax.text.prompts import check_prompt
from t2m_jax.text.rewording import reword
from t2m_jax.text.sequence import split_sequence
from t2m_jax.text.verbs import words_of
from t2m_jax.yaml_file import load_yaml

logger = logging.getLogger(__name__)

MAX_FILE_BYTES = 2_000_000
"""Largest file of lessons that is read: 30,000 sentences. PyYAML needs seconds for it."""
AT_ONCE = ("while {}", "{}", "{} all the while", "and at the same time {}")
"""How a second action is added, as a gerund: "while waving"."""
HELD_OUT_EVERY = 10
"""Of a meaning with so many sentences, every tenth is not taught, to see what is understood afterwards."""
NUM_KEPT = 5000
"""Clips of a data set with a caption whose meaning must not change, at most."""
NUM_REWORDED = 20
"""Wordings of each of a model's captions that stay, where its data set is not there."""


class Lesson(NamedTuple):
    """A sentence, and another one whose text embedding it is to get."""

    sentence: str
    like: str
    meaning: str
    """The sentence of the file that it belongs to; `like` may say more, such as how."""


def load_lessons(path: Path) -> tuple[tuple[Lesson, ...], tuple[Lesson, ...]]:
    """Returns the lessons of a YAML file, and those that are held out, of which none is taught.

    The file has lists of sentences by a sentence that the model understands. What names a side is also a lesson for the
    other side.

    Raises:
        UserError: The file has something else than such lists, or a sentence under two meanings.
    """
    meanings: dict[str, str] = {}
    taught: list[Lesson] = []
    held_out: list[Lesson] = []
    table = load_yaml(path, max_bytes=MAX_FILE_BYTES).data
    with naming(path):
        for meaning, sentences in table.items():
            for number, lesson in enumerate(_lessons_of(meaning, sentences), 1):
                group = held_out if number % HELD_OUT_EVERY == 0 else taught
                for one in _with_mirrored(lesson):
                    known = meanings.setdefault(one.sentence.lower(), one.meaning)
                    if known != one.meaning:
                        raise UserError(f"{one.sentence!r} is under {known!r} and under {one.meaning!r}")
                    group.append(one)
        held = {one.sentence.lower() for one in held_out}
        taught = [one for one in taught if one.sentence.lower() not in held]
        if not taught:
            raise UserError("has no sentences; give lists of new sentences by one that the model understands")
    return tuple(dict.fromkeys(taught)), tuple(dict.fromkeys(held_out))


def _lessons_of(meaning: Any, sentences: Any) -> list[Lesson]:
    """Returns the lessons of one entry of a file.

    Raises:
        UserError: It is not a sentence with a list of others.
    """
    if not isinstance(meaning, str) or not isinstance(sentences, list):
        raise UserError(f"{meaning!r}: expected a sentence with a list of others, such as `a person waves: [say hi]`")
    for sentence in sentences:
        if not isinstance(sentence, str):
            raise UserError(f"{meaning!r}: {sentence!r} is not a sentence; put it in quotes")
    meaning = check_prompt(meaning)
    return [Lesson(check_prompt(sentence), meaning, meaning) for sentence in sentences]


def _with_mirrored(lesson: Lesson) -> list[Lesson]:
    mirrored = Lesson(*map(mirror_caption, lesson))
    # "wave L" has no word for a side that would be found.
    has_side = mirrored.sentence != lesson.sentence and mirrored.meaning != lesson.meaning
    return [lesson, mirrored] if has_side else [lesson]


def known_meanings(lessons: Iterable[Lesson], knowledge: Knowledge) -> frozenset[str]:
    """Returns the meanings of lessons that a model can know; a line in the log names each other one.

    Raises:
        UserError: There is none.
    """
    found = dict.fromkeys(lesson.meaning for lesson in lessons)
    warnings = {meaning: check_coverage(meaning, knowledge, read_part=meaning).warning for meaning in found}
    for warning in filter(None, warnings.values()):
        logger.warning("%s; the sentences under it are not taught", warning)
    known = frozenset(meaning for meaning, warning in warnings.items() if not warning)
    if not known:
        raise UserError("the model knows none of the meanings; it can only learn other words for what it knows")
    return known


def vary_lessons(lessons: Iterable[Lesson], generator: random.Random) -> Iterator[Lesson]:
    """Yields each lesson, and again with a typing mistake, with a manner or a pace, and with a second action at once.

    So a new sentence is understood with what may follow it, and not only alone.
    """
    manners = _manners()
    at_once = _second_actions()
    for lesson in lessons:
        yield lesson
        yield lesson._replace(sentence=as_typed(with_typo(lesson.sentence, generator), generator))
        if lesson.sentence.endswith("?"):
            continue
        manner = generator.choice(generator.choice(manners))
        second = generator.choice(AT_ONCE).format(generator.choice(generator.choice(at_once)))
        for ending in (manner, second):
            sentence = f"{lesson.sentence.rstrip(' .!')} {ending}"
            yield lesson._replace(sentence=sentence, like=f"{lesson.like} {ending}")


def _manners() -> list[list[str]]:
    """Returns the words for each style and pace that can end a sentence."""
    words = load_wordings()
    groups = [style.manners for style in words.styles.values()]
    groups += words.extremes.values()
    texts = [[one.text for one in group if one.place == "end" and "{" not in one.text] for group in groups]
    return [group for group in texts if group]


def _second_actions() -> list[list[str]]:
    """Returns what can be done at the same time, by content: "waving the left hand"."""
    table = read_words("t2m_jax.data.composing", "composed")
    nobody = Subject("a person", "their")
    groups = []
    for name in (*table["legs"], *table["arms"]):
        content = load_wordings().contents[name]
        predicates = [one.predicate for one in content.wordings if not one.needs and one.nominal_form is None]
        groups.append([clause(text, nobody, form="gerund", side=content.side) for text in predicates])
    return groups


def kept_captions(dataset: Dataset | None, training_data: Mapping[str, Any] | None, *, seed: int) -> list[str]:
    """Returns captions that must keep their meaning, also each of their actions in turn, as they are sampled.

    Args:
        dataset: The model's, of whose training clips a caption is taken; None takes those of the record, in other
            wordings, too.
        training_data: The record of the model's training data.
        seed: Of the choice.
    """
    generator = np.random.default_rng(seed)
    if dataset is None:
        captions = (training_data or {}).get("captions", ())
        reworded = [reword(caption, generator) for caption in captions for _ in range(NUM_REWORDED)]
        found = [*captions, *reworded]
    else:
        clips = dataset.clips("train")  # without those that lists name and that cannot be used
        drawn = [clips[number].captions for number in generator.permutation(len(clips))[:NUM_KEPT]]
        found = [captions[generator.integers(len(captions))].text for captions in drawn if captions]
    actions = make_knowledge(training_data).actions
    parts = [part for caption in found for part in split_sequence(caption, actions)]
    return list(dict.fromkeys([*found, *parts]))


def with_taught_words(training_data: Mapping[str, Any] | None, lessons: Iterable[Lesson]) -> dict[str, Any] | None:
    """Returns the record of a model's training data with the words of lessons as `taught`; None if there is none.

    A verb is taught if two sentences of a meaning have it. Numbers, directions and single letters are not: "turn L 90"
    does not teach what 80 or R means.
    """
    if training_data is None:
        return None
    uses = Counter((lesson.meaning, word) for lesson in lessons for word in words_of(lesson.sentence))
    found = {word.text for (_, word), count in uses.items() if count > 1 or not word.action}
    words = {text for text in found - NUMBERS - DIRECTIONS if text.isalpha() and len(text) > 1}
    taught = words.union(training_data.get("taught", ())) - make_knowledge({**training_data, "taught": ()}).words
    return {**training_data, "taught": sorted(taught)}
