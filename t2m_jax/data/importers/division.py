"""How imported clips are divided into train, val and test."""

import dataclasses
import functools
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path

from t2m_jax.data.files import SPLITS, read_names
from t2m_jax.data.folder import first_names
from t2m_jax.data.importers.caption_files import Source, clip_name
from t2m_jax.data.importers.caption_table import SPLIT, CaptionTable, find_entries
from t2m_jax.data.importers.table_parts import TablePart
from t2m_jax.data.splits import parse_shares, split_by_hash, split_groups
from t2m_jax.errors import UserError

EIGHTY = "80/5/15"
"""The shares of HumanML3D."""
BY_FOLDER = "folder"
"""Clips of one folder stay together."""


@dataclasses.dataclass(frozen=True)
class Division:
    """A way to divide clips."""

    split: str | Path
    """Shares of train, val and test, or a folder with lists of clip names."""
    split_by: str | None
    """What clips have in common that stay in one split: `folder`, or a column of the table of captions."""
    source: Path
    """Folder of the motion files."""
    table: CaptionTable
    seed: int

    @property
    def is_in_table(self) -> bool:
        """Whether a column of the table has the splits, and nothing else was asked for."""
        return SPLIT in self.table.columns and self.split == EIGHTY and self.split_by is None

    def check(self) -> None:
        """Raises `UserError` if the shares are wrong, a list is missing, or the table has no such column."""
        if Path(self.split).is_dir():
            if self.split_by is not None:
                raise UserError(f"split_by {self.split_by!r}: {self.split} has lists already; give one of both")
            # Read now, so that a wrong list is reported before the long conversion.
            _ = self._homes
        else:
            parse_shares(str(self.split))
        columns = (BY_FOLDER, *self.table.columns)
        if self.split_by is not None and self.split_by not in columns:
            known = ", ".join(columns)
            raise UserError(f"split_by {self.split_by!r}: the table of captions has no such column; known: {known}")

    def divide(self, groups: Mapping[str, str]) -> dict[str, list[str]]:
        """Returns split -> names of clips.

        Args:
            groups: Clip name -> its group.

        Raises:
            UserError: There are fewer groups than splits.
        """
        if self.is_in_table or Path(self.split).is_dir():
            return {split: [name for name, group in groups.items() if group == split] for split in SPLITS}
        shares = parse_shares(str(self.split))
        members: dict[str, list[str]] = defaultdict(list)
        for name, group in groups.items():
            members[group].append(name)
        # Of fewer recordings than splits, parts are divided, although they are alike.
        num_splits = sum(share > 0 for share in shares.values())
        has_parts = num_splits <= len(members) < len(groups)
        if self.split_by is None and not has_parts:
            return split_by_hash([list(groups)], seed=str(self.seed), shares=shares)
        return split_groups(members, shares=shares, seed=str(self.seed))

    @functools.cached_property
    def _homes(self) -> dict[str, str]:
        """Returns clip name -> split."""
        listed = [(split, name) for split in SPLITS for name in read_names(Path(self.split) / f"{split}.txt")]
        twice = [name for name, count in Counter(name for _, name in listed).items() if count > 1]
        if twice:
            raise UserError(f"{self.split}: {twice[0]} is in two lists or twice in one; name each clip once")
        return {clip_name(name): split for split, name in listed}

    def absent(self, names: Iterable[str]) -> list[str]:
        """Returns a line about the listed clips that are not among some, if there are any."""
        absent = sorted(self._homes.keys() - set(names)) if Path(self.split).is_dir() else []
        return [f"{self.split}: {len(absent)} listed clips are no motion: {first_names(absent)}"] if absent else []

    def group(self, motion: Source, part: TablePart) -> str:
        """Returns what a clip has in common with those that stay in its split, or the split itself if it is given.

        Args:
            motion: The motion of the clip.
            part: The part of the motion that it is.

        Raises:
            UserError: The clip is in no list, its rows have several values or none, or another split.
        """
        if self.is_in_table:
            split = part.split or self._cell(motion, SPLIT)
            if split not in SPLITS:
                raise UserError(f"{motion}: split {split!r} is not {', '.join(SPLITS)}")
            return split
        if Path(self.split).is_dir():
            if part.name not in self._homes:
                raise UserError(f"{motion}: {part.name} is in no list of {self.split}")
            return self._homes[part.name]
        if self.split_by is None:
            # Parts of one recording are alike, and may show the same frames.
            return clip_name(motion.key(self.source))
        if self.split_by == BY_FOLDER:
            return motion.path.parent.relative_to(self.source).as_posix()
        return self._cell(motion, self.split_by)

    def _cell(self, motion: Source, column: str) -> str:
        """Returns what all rows of a motion say in a column."""
        values = {row.cells[column] for row in find_entries(self.table, motion.keys(self.source))}
        if len(values) != 1 or not all(values):
            said = " and ".join(sorted(values - {""})) or f"no {column}"
            raise UserError(f"{motion}: its rows have {said}; write one {column} into all")
        return values.pop()
