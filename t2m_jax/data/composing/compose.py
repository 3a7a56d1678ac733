"""Adding motions that are made of the training clips of a labeled data set."""

import dataclasses
import functools
import random
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from pathlib import Path
from typing import Any, NamedTuple

import tqdm

from t2m_jax.data.captioning.captions import CAPTIONS, Labels
from t2m_jax.data.captioning.sequences import (
    write_count_captions,
    write_duration_captions,
    write_then_captions,
    write_while_captions,
)
from t2m_jax.data.captioning.wordings import load_wordings
from t2m_jax.data.composing.at_once import draw_at_once
from t2m_jax.data.composing.extra import (
    EXTRA_PREFIXES,
    Composed,
    NewClip,
    write_new_clip,
    write_slow_clips,
    write_stand_clips,
)
from t2m_jax.data.composing.lasting import draw_lasting
from t2m_jax.data.composing.pieces import REACH, Library, drawn_weights, join_pieces, make_library
from t2m_jax.data.composing.repeated import draw_repeated
from t2m_jax.data.composing.turns import draw_pieces
from t2m_jax.data.files import MIRROR_PREFIX
from t2m_jax.data.folder import Dataset, open_dataset
from t2m_jax.data.index import ClipIndex, IndexEntry, load_index, save_index
from t2m_jax.data.merge import copy_clip, index_entries, read_splits
from t2m_jax.data.workers import Mapper, map_in_processes
from t2m_jax.data.writer import ImportReport, check_count, finish_folder, new_folder, with_twins
from t2m_jax.errors import UserError


@dataclasses.dataclass(frozen=True, kw_only=True)
class ComposeOptions:
    """What is added to a data set."""

    turns: int = 0
    """Motions of two or three actions in turn."""
    at_once: int = 0
    """Motions with the legs of one clip and the arms of another."""
    repeated: int = 0
    """Motions in which something is done once to five times."""
    timed: int = 0
    """Motions that last two to nine whole seconds."""
    still: bool = False
    """Motions of standing still, cut out of clips."""
    slow: bool = False
    """Slow clips once more, played very slowly."""
    seed: int = 0
    workers: int = 1
    """Number of processes."""

    def counts(self) -> dict[str, int]:
        """Returns how many motions of each kind are made.

        Raises:
            UserError: A number is negative or too large, or nothing is asked for.
        """
        counts = {kind: getattr(self, kind) for kind in KINDS}
        for kind, count in counts.items():
            check_count(kind, count, least=0)
        if not (any(counts.values()) or self.still or self.slow):
            raise UserError("nothing to compose; give --turns, --at-once, --repeated, --timed, --still or --slow")
        return counts


def compose_dataset(source: str | Path, destination: str | Path, **options: Any) -> ImportReport:
    """Writes a data set with all clips of another one and, for training, motions made of its training clips.

    Args:
        source: Folder of a data set with labels in `index.csv`.
        destination: Folder to make.
        **options: Fields of `ComposeOptions`.

    Raises:
        UserError: No training clip has a label that can be put into words, no clips fit, or the destination exists.
    """
    given = ComposeOptions(**options)
    counts = given.counts()
    dataset = open_dataset(source)
    index = load_index(dataset.folder)
    labels = known_labels(index, dataset.names("train")) if index else {}
    if index is None or not labels:
        raise UserError(f"{dataset.folder}: no training clip has a label in index.csv that can be put into words")
    splits = read_splits(dataset)
    names = [name for members in splits.values() for name in members]
    known = frozenset(names)
    if composed := [name for name in names if _is_made(name, known)]:
        raise UserError(f"{dataset.folder}: {composed[0]} is composed already; compose the data set it was made of")
    with new_folder(destination) as folder, map_in_processes(given.workers) as run_all:
        frames = sum(copy_clip(name, dataset, folder) for name in names)
        new = _write_all(folder, labels, given, counts, run_all)
        splits["train"] += with_twins([clip.name for clip in new])
        sizes = finish_folder(folder, splits, info=dataset.info, skeleton=dataset.skeleton)
        save_index(folder, [*index_entries(dataset, names), *_entries(new, index, dataset)])
    frames += 2 * sum(clip.num_frames for clip in new)
    return ImportReport(len(names) + 2 * len(new), frames, sizes, {}, (f"{len(new)} motions added to train",))


def known_labels(index: ClipIndex, names: Iterable[str]) -> dict[str, Labels]:
    """Returns the labels of recorded clips that can be put into words, without twins and composed clips."""
    words = load_wordings()
    found = {}
    for name in names:
        content, _, style = (index.label(name) or "").partition(", ")
        if not name.startswith(MIRROR_PREFIX) and content in words.contents and style in words.styles:
            found[name] = Labels(content, style)
    return found


def _is_made(name: str, known: Set[str]) -> bool:
    """Returns whether a name is that of a motion that was made of the known clips."""
    prefix, _, origin = name.partition("_")
    # A recording may be called `slow1_walk`, if there is no `walk` that it was made of.
    return prefix in {kind.prefix for kind in KINDS.values()} or (prefix in EXTRA_PREFIXES and origin in known)


def still_labels(still: Iterable[NewClip]) -> dict[str, Labels]:
    """Returns the labels of motions of standing still, which can be parts of others."""
    return {clip.name: Labels(*clip.label.split(", ")) for clip in still}


def _write_all(
    folder: Path, labels: Mapping[str, Labels], given: ComposeOptions, counts: Mapping[str, int], run_all: Mapper
) -> list[NewClip]:
    still = write_stand_clips(folder, labels) if given.still else []
    slow = write_slow_clips(folder, labels) if given.slow else []
    labels = {**labels, **still_labels(still)}
    weights = drawn_weights(label.content for label in labels.values())
    library = make_library(folder, labels, weights=weights, reach=REACH)
    new = [*still, *slow]
    for kind, count in counts.items():
        made = run_all(functools.partial(write_composition, kind, library=library, seed=given.seed), range(count))
        new += tqdm.tqdm(made, total=count, unit="clip", desc=f"write {kind.replace('_', ' ')}", disable=not count)
    return new


def _entries(new: Sequence[NewClip], index: ClipIndex, dataset: Dataset) -> list[IndexEntry]:
    """Returns the rows of new clips, with the licenses of all clips that each is made of."""
    made = {clip.name: clip for clip in new}

    def recorded(name: str) -> list[str]:
        # A motion of standing still is made of a clip, and may be a part of another motion.
        return [one for origin in made[name].origins for one in recorded(origin)] if name in made else [name]

    def joined(texts: Iterable[str]) -> str:
        return "; ".join(sorted(set(filter(None, texts))))

    rows = []
    for clip in new:
        origins = [index.entry(name) for name in recorded(clip.name)]
        origins = [one.with_origin(dataset.info.name, dataset.info.licence) for one in origins]
        persons = joined(one.person for one in origins)
        datasets = joined(one.dataset for one in origins)
        rows.append(IndexEntry(clip.name, "", clip.label, persons, datasets, joined(one.licence for one in origins)))
    return rows


def _make_turns(library: Library, generator: random.Random) -> Composed:
    pieces = draw_pieces(library, generator)
    labels = [piece.labels for piece in pieces]
    facts = [piece.facts for piece in pieces]
    captions = write_then_captions(labels, facts=facts, count=CAPTIONS, generator=generator)
    label = " + ".join(one.content for one in labels)
    return Composed(label, join_pieces(pieces), captions, [piece.name for piece in pieces])


def _make_at_once(library: Library, generator: random.Random) -> Composed:
    legs, arms, positions = draw_at_once(library, generator)
    captions = write_while_captions(legs.labels, arms.labels, count=CAPTIONS, generator=generator)
    label = f"{legs.labels.content} + {arms.labels.content}, at once"
    return Composed(label, positions, captions, [legs.name, arms.name])


def _make_repeated(library: Library, generator: random.Random) -> Composed:
    piece, times = draw_repeated(library, generator)
    captions = write_count_captions(piece.labels, times, count=CAPTIONS, generator=generator)
    return Composed(f"{piece.labels.content} x {times}", piece.positions, captions, [piece.name])


def _make_timed(library: Library, generator: random.Random) -> Composed:
    piece, seconds = draw_lasting(library, generator)
    captions = write_duration_captions(piece.labels, seconds, count=CAPTIONS, generator=generator)
    return Composed(f"{piece.labels.content}, {seconds} s", piece.positions, captions, [piece.name])


class _Kind(NamedTuple):
    """A kind of motions that are made of clips."""

    prefix: str
    """What their names begin with."""
    seed: str
    """What the seeds of their draws begin with."""
    make: Callable[[Library, random.Random], Composed]


KINDS = {
    "turns": _Kind("composed", "composition", _make_turns),
    "at_once": _Kind("atonce", "at once", _make_at_once),
    "repeated": _Kind("repeated", "repeated", _make_repeated),
    "timed": _Kind("timed", "timed", _make_timed),
}
"""Fields of `ComposeOptions` that count motions -> what they are."""


def write_composition(kind: str, number: int, *, library: Library, seed: int = 0) -> NewClip:
    """Writes a motion that is made of clips; its number decides which."""
    how = KINDS[kind]
    # All draws of a motion are its own, so that none changes when others are added.
    generator = random.Random(f"{how.seed} {number}" + f" of {seed}" * (seed != 0))
    return write_new_clip(library.folder, f"{how.prefix}_{number:05d}", how.make(library, generator))
