"""Captions of a folder of motion files: from a table, from text files beside them, or from their names."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from t2m_jax.data.importers.lexicon import tag_words
from t2m_jax.data.texts import Caption, parse_caption
from t2m_jax.errors import UserError
from t2m_jax.files import load_text

CAPTION_FILES = ("captions.csv", "captions.txt")
BYTE_ORDER_MARK = "\ufeff"
"""Some editors and spreadsheets write it at the beginning of a UTF-8 file."""


class Source(NamedTuple):
    """A motion to import."""

    path: Path
    animation: str | None
    """Its name in a file of several animations, without the name of the armature."""

    def key(self, folder: Path) -> str:
        """Returns what a table of captions calls it: its path below `folder`, then its animation."""
        place = self.path.relative_to(folder).with_suffix("").as_posix()
        return place if self.animation is None else f"{place}/{self.animation}"

    def short_keys(self) -> tuple[str, ...]:
        """Returns what a table may call it, too: without the folder, an animation also without its file."""
        stem = self.path.stem
        return (stem,) if self.animation is None else (f"{stem}/{self.animation}", self.animation)

    def __str__(self) -> str:
        return str(self.path) if self.animation is None else f"{self.path}: {self.animation}"


def _tagged_caption(text: str, *, source: str, start: str = "", end: str = "") -> Caption:
    """Returns a caption with tokens from plain text."""
    if "#" in text:
        raise UserError(f"{source}: the caption has a '#', which the text format cannot store; remove it")
    text = " ".join(text.split())
    line = f"{text}#{' '.join(_tokens(text, source=source))}#{start.strip() or 0.0}#{end.strip() or 0.0}"
    return parse_caption(line, source=source)


def _tokens(text: str, *, source: str) -> tuple[str, ...]:
    """Returns the tokens of a caption, of which there must be some."""
    tokens = tag_words(text)
    if not tokens:
        raise UserError(f"{source}: the caption {text[:40]!r} has no words; say what the motion shows")
    return tokens


def load_caption_table(source: Path, captions: Path | None) -> dict[str, list[Caption]]:
    """Returns file stem -> captions from a file: the given one, or `captions.csv` or `captions.txt` in the folder.

    A `.csv` file has the columns file, caption and, optionally, start and end. Any other file has lines `file: caption`
    (or a tab in place of the colon).

    Raises:
        UserError: The given file is missing, is not UTF-8 or has a broken line, which the message names.
    """
    path = captions or next((source / name for name in CAPTION_FILES if (source / name).is_file()), None)
    if path is None:
        return {}
    if not path.is_file():
        raise UserError(f"{path}: no such file; give a .csv with file,caption or a .txt with 'file: caption' lines")
    text = load_text(path).removeprefix(BYTE_ORDER_MARK)
    rows: list[tuple[int, str | None, str | None, str, str]] = []
    if path.suffix == ".csv":
        reader = csv.DictReader(io.StringIO(text))
        try:
            rows += [
                (reader.line_num, row.get("file"), row.get("caption"), row.get("start") or "", row.get("end") or "")
                for row in reader
            ]
        except csv.Error as error:
            raise UserError(f"{path}:{reader.line_num}: is not a table ({error}); save it as CSV") from error
        if not {"file", "caption"} <= set(reader.fieldnames or ()):
            raise UserError(f"{path}:1: expected the columns file,caption[,start,end]")
    else:
        for number, line in enumerate(text.split("\n"), start=1):
            parts = line.partition("\t" if "\t" in line else ":")
            rows += [(number, parts[0], parts[2], "", "")] * bool(line.strip())
    result: dict[str, list[Caption]] = {}
    for number, file, said, start, end in rows:
        if not file or not said or not said.strip():
            raise UserError(f"{path}:{number}: file or caption is empty; fill in both or remove the line")
        stem = re.sub(r"\.bvh$", "", file.strip().replace("\\", "/"), flags=re.IGNORECASE)
        result.setdefault(stem, []).append(_tagged_caption(said, source=f"{path}:{number}", start=start, end=end))
    return result


def find_captions(
    motion: Source, folder: Path, *, table: Mapping[str, Sequence[Caption]], from_name: bool
) -> tuple[Caption, ...]:
    """Returns the captions of a motion: from the table, from the text file beside a BVH file, or from its name.

    The text file has plain lines or HumanML3D's four fields.

    Raises:
        UserError: There is none, or the text file cannot be read.
    """
    keys = dict.fromkeys((motion.key(folder), *motion.short_keys()))
    captions = [caption for key in keys for caption in table.get(key, ())]
    beside = motion.path.with_suffix(".txt")
    is_read = motion.animation is None and beside.is_file()
    text = load_text(beside).removeprefix(BYTE_ORDER_MARK) if is_read else ""
    for number, line in enumerate(text.split("\n"), start=1):
        place = f"{beside}:{number}"
        if line.count("#") == 3:
            caption = parse_caption(line, source=place)
            captions.append(caption._replace(tokens=caption.tokens or _tokens(caption.text, source=place)))
        elif line.strip():
            captions.append(_tagged_caption(line, source=place))
    words = re.sub(r"[\W\d_]+", " ", motion.short_keys()[-1]).strip().lower()
    if not captions and from_name and words:
        captions = [_tagged_caption(words, source=str(motion))]
    if not captions:
        raise UserError(f"{motion}: no caption; add it to captions.csv or use --caption-from-name")
    return tuple(dict.fromkeys(captions))
