"""The table `index.csv` of a data-set folder: the recordings that clips were cut from, and labels of their motion.

It is HumanML3D's own table (`new_name`, `source_path` and others) with columns of ours: `label`, and where clips come
from. The file is optional, and so is every column except `new_name`.
"""

import csv
import io
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from t2m_jax.data.files import MIRROR_PREFIX
from t2m_jax.errors import UserError
from t2m_jax.files.reading import reading
from t2m_jax.files.writing import save_text
from t2m_jax.motion.mirroring import mirror_caption

INDEX = "index.csv"
NAME = "new_name"
SOURCE = "source_path"
LABEL = "label"
ORIGINS = ("person", "dataset", "licence")


class IndexEntry(NamedTuple):
    """One clip of the table."""

    name: str
    source: str
    label: str
    person: str = ""
    """Who moves."""
    dataset: str = ""
    """Name of the data set that it was taken from, if its folder has several."""
    licence: str = ""
    """Its license, if its folder has several."""

    def with_origin(self, dataset: str, licence: str) -> "IndexEntry":
        """Returns the row with a data set and a license, where it has none."""
        return self._replace(dataset=self.dataset or dataset, licence=self.licence or licence)


_COUNT = re.compile(r" x \d+$")
_SECONDS = re.compile(r" \d+ s")


def label_actions(label: str) -> tuple[str, ...]:
    """Returns the actions of a label, without its style.

    Labels are `walk, happy`, of actions in turn `walk + bow`, of two at once `walk + clap, at once`, of an action that
    is repeated `jump x 3`, and of one that lasts some seconds `walk, 5 s`.
    """
    return tuple(_COUNT.sub("", action) for action in label.partition(",")[0].split(" + "))


def is_single(label: str) -> bool:
    """Returns whether a label is of one action that is done once, not of several, a number of times or some seconds."""
    actions, _, style = label.partition(",")
    return " + " not in actions and not _COUNT.search(actions) and not _SECONDS.fullmatch(style)


def action_of(label: str) -> str:
    """Returns the action of a label; of several actions, how many there are, in turn or at once."""
    actions = label_actions(label)
    if len(actions) == 1:
        return actions[0]
    return f"{len(actions)} actions {'at once' if label.endswith(', at once') else 'in turn'}"


class ClipIndex(NamedTuple):
    """Recordings and labels by clip name. Mirrored twins need no entry: theirs follow from the original."""

    entries: Mapping[str, IndexEntry] = {}

    def entry(self, name: str) -> IndexEntry:
        """Returns what is known of a clip. A twin without an entry has that of its original, mirrored."""
        if name in self.entries:
            return self.entries[name]
        original = self.entries.get(name.removeprefix(MIRROR_PREFIX), IndexEntry(name, "", ""))
        return original._replace(name=name, label=mirror_caption(original.label))

    def source(self, name: str) -> str | None:
        """Returns the recording that a clip was cut from, or None if it is not known."""
        return self.entry(name).source or None

    def label(self, name: str) -> str | None:
        """Returns the label of a clip, or None if it is not known. A twin has left and right exchanged."""
        return self.entry(name).label or None

    def has(self, column: str) -> bool:
        """Returns whether a column, such as "label", is known of any clip."""
        return any(getattr(entry, column) for entry in self.entries.values())

    def recorded_with(self, names: Iterable[str], others: Iterable[str]) -> frozenset[str]:
        """Returns the clips of `names` that share a known recording with one of `others`."""
        # Two clips of unknown recordings have nothing in common.
        recordings = {self.source(name) for name in others} - {None}
        return frozenset(name for name in names if self.source(name) in recordings)


def load_index(folder: str | Path) -> ClipIndex | None:
    """Returns the table of a data-set folder, or None if there is none.

    Raises:
        UserError: The file cannot be read, or has no column `new_name`.
    """
    path = Path(folder) / INDEX
    if not path.exists():
        return None
    try:
        with reading(path), path.open(encoding="utf-8-sig", newline="") as lines:
            entries = list(csv.DictReader(lines))
    except csv.Error as error:
        raise UserError(f"{path}: cannot be read ({error}); expected a table with the column {NAME}") from error
    if entries and NAME not in entries[0]:
        raise UserError(f"{path}: has no column {NAME}; its columns are {', '.join(map(str, entries[0]))}")
    # HumanML3D's table has file names in place of clip names.
    named = (((entry[NAME] or "").removesuffix(".npy"), entry) for entry in entries)
    columns = (SOURCE, LABEL, *ORIGINS)
    known = {name: IndexEntry(name, *(entry.get(column) or "" for column in columns)) for name, entry in named}
    return ClipIndex(known)


def save_index(folder: str | Path, entries: Iterable[IndexEntry]) -> None:
    """Writes `index.csv`. Mirrored twins need no entry. Columns of origins are left out if all of them are empty."""
    rows = list(entries)
    width = 6 if any(any(entry[3:]) for entry in rows) else 3
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow((NAME, SOURCE, LABEL, *ORIGINS)[:width])
    writer.writerows(entry[:width] for entry in rows)
    save_text(Path(folder) / INDEX, table.getvalue())
