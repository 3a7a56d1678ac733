"""Captions of a folder of motion files: from a table, from text files next to them, or from their names."""

import re
import unicodedata
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from textwrap import shorten
from typing import NamedTuple

from t2m_jax.data.files import MAX_NAME
from t2m_jax.data.importers.caption_table import CaptionEntry, CaptionTable, find_entries, load_caption_table
from t2m_jax.data.importers.plain_captions import caption_tokens, tagged_caption, with_span
from t2m_jax.data.texts import Caption, parse_caption
from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_text

CAPTION_FILES = ("captions.csv", "captions.tsv", "captions.txt")
LONGEST_NAME = MAX_NAME - 20
"""Bytes of a clip's name: mirrored twins, and what is composed of clips, have longer ones."""


class Source(NamedTuple):
    """A motion to import."""

    path: Path
    animation: str | None
    """Its name in a file of several animations, without the name of the armature."""

    def key(self, folder: Path) -> str:
        """Returns what a table of captions calls it: its path below `folder`, then its animation."""
        place = self.path.relative_to(folder).with_suffix("").as_posix()
        return unicodedata.normalize("NFC", place if self.animation is None else f"{place}/{self.animation}")

    def keys(self, folder: Path) -> tuple[str, ...]:
        """Returns all that a table may call it: also without the folder, an animation also without its file."""
        stem = unicodedata.normalize("NFC", self.path.stem)
        short = (stem,) if self.animation is None else (f"{stem}/{self.animation}", self.animation)
        return (self.key(folder), *short)

    def __str__(self) -> str:
        return str(self.path) if self.animation is None else f"{self.path}: {self.animation}"


def clip_name(key: str) -> str:
    """Returns the clip name of a motion by its key, without a leading M, which marks mirrored twins.

    Raises:
        UserError: The key has no letters or digits, or is too long.
    """
    name = re.sub(r"[^\w-]+", "_", key).strip("_")
    if not 0 < len(name.encode()) <= LONGEST_NAME:
        raise UserError(f"{key}: the name of a clip has 1 to {LONGEST_NAME} bytes of letters and digits; rename it")
    return f"m{name[1:]}" if name.startswith("M") else name


def find_table(source: Path, captions: Path | None, *, files: Collection[Path]) -> CaptionTable:
    """Returns the table of captions: the given one, or one of `CAPTION_FILES` in the folder, or an empty one.

    Raises:
        UserError: The given file is missing, is not UTF-8, or is no table of files and captions.
    """
    path = captions or next((source / name for name in CAPTION_FILES if (source / name).is_file()), None)
    if path is None:
        return CaptionTable({})
    return load_caption_table(path, keys=[Source(file, None).key(source) for file in files])


def find_captions(
    motion: Source, rows: Sequence[CaptionEntry], *, only_table: bool, from_name: bool
) -> tuple[Caption, ...]:
    """Returns the captions of a motion: from its rows of the table, from the text file next to it, or from its name.

    The text file has plain lines or HumanML3D's four fields. With `only_table`, it is not read.

    Raises:
        UserError: There is none, or the text file cannot be read.
    """
    captions = [caption for row in rows for caption in row.captions]
    beside = motion.path.with_suffix(".txt")
    is_read = motion.animation is None and not only_table and beside.is_file()
    text = load_text(beside) if is_read else ""
    for number, line in enumerate(text.split("\n"), start=1):
        place = f"{beside}:{number}"
        if line.count("#") == 3:
            caption = with_span(parse_caption(line, source=place), source=place)
            captions.append(caption._replace(tokens=caption.tokens or caption_tokens(caption.text, source=place)))
        elif line.strip():
            captions.append(tagged_caption(line, source=place))
    # Digits in names count takes; they say nothing of the motion.
    words = re.sub(r"[\W\d_]+", " ", motion.animation or motion.path.stem).strip().lower()
    if not captions and from_name and words:
        captions = [tagged_caption(words, source=str(motion))]
    if not captions:
        problem = next((row.problem for row in rows if row.problem), "")
        add = "add it to captions.csv"
        advice = f"its name has no words; {add}" if from_name else f"{add} or use --caption-from-name"
        raise UserError(problem or f"{motion}: no caption; {advice}")
    # A caption may be in the table and in the text file.
    return tuple(dict.fromkeys(captions))


def captions_within(captions: Iterable[Caption], *, begin: float, seconds: float) -> tuple[Caption, ...]:
    """Returns captions with times counted from `begin`, without those about other parts than the `seconds` from there.

    Raises:
        UserError: None is left.
    """
    kept = []
    for caption in captions:
        start = max(round(caption.start - begin, 3), 0.0)
        end = round(caption.end - begin, 3) if caption.end else seconds
        if caption.whole_clip:
            kept.append(caption)
        elif start < min(end, seconds):
            kept.append(caption._replace(start=start, end=end))
    if not kept:
        raise UserError(f"its captions are about none of its {begin + seconds:.2f} s; give times in seconds")
    return tuple(kept)


def is_named(table: CaptionTable, keys: Sequence[str]) -> bool:
    """Returns whether a row of a table calls a file, or an animation in it, by one of some keys."""
    names = (entry.file.casefold() for entries in table.entries.values() for entry in entries)
    return any(f"{name}/".startswith(f"{key.casefold()}/") for name in names for key in keys)


def unused_entries(table: CaptionTable, motions: Collection[Source], folder: Path) -> list[str]:
    """Returns a line for each row that gave no caption: what is wrong with it, or that it names no motion."""
    used = {row.place for motion in motions for row in find_entries(table, motion.keys(folder))}
    rows = [row for same in table.entries.values() for row in same if row.problem or row.place not in used]
    # By the number of the line, because rows of one motion are together in the table.
    rows.sort(key=lambda row: int(row.place.rpartition(":")[2]))
    animations: dict[str, list[str]] = defaultdict(list)
    for motion in motions:
        if motion.animation is not None:
            animations[motion.path.stem.casefold()].append(f"{motion.path.stem}/{motion.animation}")
    return [row.problem or f"{row.place}: {_absent(row, animations)}" for row in rows]


def _absent(row: CaptionEntry, animations: Mapping[str, Sequence[str]]) -> str:
    """Returns why a row names no motion; `animations` are those of files by their names."""
    found = animations.get(row.file.rpartition("/")[2].casefold())
    if found is None:
        return f"there is no motion {row.file}"
    return f"{row.file} is a file with animations; write one of them: {shorten(', '.join(map(repr, found)), 200)}"
