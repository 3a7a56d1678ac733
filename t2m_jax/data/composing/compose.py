"""Adding motions that are made of the training clips of a labeled data set."""

import dataclasses
import functools
import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import tqdm

from t2m_jax.data.captioning.captions import Labels
from t2m_jax.data.captioning.sequences import (
    write_count_captions,
    write_duration_captions,
    write_while_captions,
)
from t2m_jax.data.captioning.wordings import load_wordings
from t2m_jax.data.composing.at_once import draw_at_once
from t2m_jax.data.composing.extra import (
    CAPTIONS_OF_NEW,
    NewClip,
    write_new_clip,
    write_slow_clips,
    write_stand_clips,
)
from t2m_jax.data.composing.lasting import draw_lasting
from t2m_jax.data.composing.pieces import REACH, LabeledPiece, Library, drawn_weights, join_pieces, make_library
from t2m_jax.data.composing.repeated import draw_repeated
from t2m_jax.data.composing.turns import draw_pieces, write_composed_captions
from t2m_jax.data.files import MIRROR_PREFIX
from t2m_jax.data.folder import Dataset, open_dataset
from t2m_jax.data.index import ClipIndex, IndexEntry, load_index, save_index
from t2m_jax.data.merge import copy_clip, index_entries, read_splits
from t2m_jax.data.texts import Caption
from t2m_jax.data.workers import Mapper, map_in_processes
from t2m_jax.data.writer import ImportReport, check_count, finish_folder, new_folder, with_twins
from t2m_jax.errors import UserError

Write: TypeAlias = Callable[..., NewClip]
NAMES = {"turns": "composed", "at_once": "atonce", "repeated": "repeated", "timed": "timed"}
"""What the names of new clips begin with."""


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

    def counts(self) -> dict[Write, int]:
        """Returns how many motions each function writes.

        Raises:
            UserError: A number is negative or too large, or nothing is asked for.
        """
        counts = {
            write_turns: self.turns,
            write_at_once: self.at_once,
            write_repeated: self.repeated,
            write_timed: self.timed,
        }
        for name in NAMES:
            check_count(name, getattr(self, name), least=0)
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
    if composed := [name for name in names if name.partition("_")[0] in NAMES.values()]:
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


def _write_all(
    folder: Path, labels: Mapping[str, Labels], given: ComposeOptions, counts: Mapping[Write, int], run_all: Mapper
) -> list[NewClip]:
    names = list(labels)
    still = write_stand_clips(folder, names, labels.__getitem__) if given.still else []
    slow = write_slow_clips(folder, names, labels.__getitem__) if given.slow else []
    labels = {**labels, **{clip.name: Labels(*clip.label.split(", ")) for clip in still}}
    weights = drawn_weights(label.content for label in labels.values())
    library = make_library(folder, labels, weights=weights, reach=REACH)
    new = [*still, *slow]
    for write, count in counts.items():
        make = functools.partial(write, library=library, seed=given.seed)
        made = run_all(make, range(count))
        new += tqdm.tqdm(made, total=count, unit="clip", desc=write.__name__.replace("_", " "), disable=not count)
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


def write_turns(number: int, *, library: Library, seed: int = 0) -> NewClip:
    """Writes a motion of two or three actions in turn; the number decides which."""
    generator = _generator("composition", number, seed)
    pieces = draw_pieces(library, generator)
    captions = write_composed_captions(pieces, count=CAPTIONS_OF_NEW, generator=generator)
    label = " + ".join(piece.labels.content for piece in pieces)
    origins = [piece.name for piece in pieces]
    name = _name("turns", number)
    return write_new_clip(library.folder, name, label, join_pieces(pieces), captions=captions, origins=origins)


def write_at_once(number: int, *, library: Library, seed: int = 0) -> NewClip:
    """Writes a motion with the legs of one clip and the arms of another."""
    generator = _generator("at once", number, seed)
    legs, arms, positions = draw_at_once(library, generator)
    captions = write_while_captions(legs.labels, arms.labels, count=CAPTIONS_OF_NEW, generator=generator)
    label = f"{legs.labels.content} + {arms.labels.content}, at once"
    name = _name("at_once", number)
    return write_new_clip(library.folder, name, label, positions, captions=captions, origins=[legs.name, arms.name])


def write_repeated(number: int, *, library: Library, seed: int = 0) -> NewClip:
    """Writes a motion in which something is done some times."""
    generator = _generator("repeated", number, seed)
    piece, times = draw_repeated(library, generator)
    captions = write_count_captions(piece.labels, times, count=CAPTIONS_OF_NEW, generator=generator)
    label = f"{piece.labels.content} x {times}"
    return _write_piece(library, _name("repeated", number), label, piece, captions)


def write_timed(number: int, *, library: Library, seed: int = 0) -> NewClip:
    """Writes a motion that lasts some seconds."""
    generator = _generator("timed", number, seed)
    piece, seconds = draw_lasting(library, generator)
    captions = write_duration_captions(piece.labels, seconds, count=CAPTIONS_OF_NEW, generator=generator)
    label = f"{piece.labels.content}, {seconds} s"
    return _write_piece(library, _name("timed", number), label, piece, captions)


def _name(kind: str, number: int) -> str:
    return f"{NAMES[kind]}_{number:05d}"


def _write_piece(library: Library, name: str, label: str, piece: LabeledPiece, captions: Sequence[Caption]) -> NewClip:
    return write_new_clip(library.folder, name, label, piece.positions, captions=captions, origins=[piece.name])


def _generator(kind: str, number: int, seed: int) -> random.Random:
    """Returns the source of all draws of a motion, so that none changes when others are added."""
    return random.Random(f"{kind} {number}" + f" of {seed}" * (seed != 0))
