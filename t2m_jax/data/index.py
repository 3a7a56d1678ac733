"""What `index.csv` of a data-set folder tells of its clips: the recordings they were cut from, and what they show.

It is HumanML3D's own table (`new_name`, `source_path` and more) with one column of ours, `label`. It is optional, and
so is each of the two columns after `new_name`.
"""

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from t2m_jax.data.files import MIRROR_PREFIX
from t2m_jax.errors import UserError
from t2m_jax.motion.mirroring import mirror_caption

INDEX = "index.csv"
NAME, SOURCE, LABEL = "new_name", "source_path", "label"


class ClipIndex(NamedTuple):
    """Clip name -> recording, clip name -> label; mirrored twins follow from their originals."""

    sources: Mapping[str, str]
    labels: Mapping[str, str]

    def source(self, name: str) -> str | None:
        """Returns the recording that a clip was cut from, None where it is not known; a twin's is its original's."""
        return self.sources.get(name, self.sources.get(name.removeprefix(MIRROR_PREFIX)))

    def label(self, name: str) -> str | None:
        """Returns what a clip shows, None where it is not known; a twin's has left and right exchanged."""
        if name in self.labels or not name.startswith(MIRROR_PREFIX):
            return self.labels.get(name)
        label = self.labels.get(name.removeprefix(MIRROR_PREFIX))
        return None if label is None else mirror_caption(label)

    def recorded_with(self, names: Iterable[str], others: Iterable[str]) -> frozenset[str]:
        """Returns the clips of `names` that are cut from a recording of one of `others`, as far as is known."""
        recordings = {self.source(name) for name in others} - {None}
        return frozenset(name for name in names if self.source(name) in recordings)


class IndexRow(NamedTuple):
    """One clip of the table."""

    name: str
    source: str
    label: str


def load_index(folder: Path) -> ClipIndex | None:
    """Returns what the folder's `index.csv` tells, None where there is none.

    Raises:
        UserError: the file cannot be read, or has no column `new_name`.
    """
    path = folder / INDEX
    if not path.exists():
        return None
    try:
        with path.open(encoding="utf-8", newline="") as lines:
            rows = list(csv.DictReader(lines))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"{path}: cannot be read ({error}); expected a table with the column {NAME}") from error
    if rows and NAME not in rows[0]:
        raise UserError(f"{path}: has no column {NAME}; its columns are {', '.join(map(str, rows[0]))}")
    return ClipIndex(*({_stem(row): row[column] for row in rows if row.get(column)} for column in (SOURCE, LABEL)))


def _stem(row: Mapping[str, str | None]) -> str:
    """Returns the clip's name; HumanML3D's table has file names."""
    return (row[NAME] or "").removesuffix(".npy")


def save_index(folder: Path, rows: Iterable[IndexRow]) -> None:
    """Writes `index.csv`; twins need no row of their own."""
    with (folder / INDEX).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow((NAME, SOURCE, LABEL))
        writer.writerows(rows)
