"""Clips that a table cuts out of motion files and gives an action, a person and a split."""

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.data.captioning.captions import Labels, write_captions
from t2m_jax.data.captioning.wordings import load_wordings
from t2m_jax.data.files import SPLITS
from t2m_jax.data.importers.caption_files import Source
from t2m_jax.data.importers.caption_table import ACTION, DIGEST, PERSON, SPLIT, CaptionEntry, CaptionTable
from t2m_jax.data.texts import Caption
from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_bytes
from t2m_jax.motion.facts import measure
from t2m_jax.motion.rig import RigClip
from t2m_jax.motion.skeleton import HUMANML3D

STYLE = "normal"
"""Style of clips of tables, if their action does not name another one after a comma."""


class TablePart(NamedTuple):
    """A part of a motion that becomes a clip."""

    name: str
    """Of the clip."""
    captions: tuple[Caption, ...]
    """Of the table."""
    span: tuple[float, float] = (0.0, 0.0)
    """Seconds of the motion; zeros are its beginning and its end."""
    action: str = ""
    """Empty if it is not known."""
    person: str = ""
    split: str = ""

    @property
    def label(self) -> str:
        """Action and style, as in `index.csv`; empty without an action. A table may give both: `bow, happy`."""
        return f"{self.action}, {STYLE}" if self.action and "," not in self.action else self.action

    def cut(self, clip: RigClip) -> RigClip:
        """Returns the part of the motion.

        Raises:
            UserError: The motion does not have it.
        """
        first = round(self.span[0] * clip.fps)
        last = round(self.span[1] * clip.fps) or clip.num_frames
        # A frame more than the file has is rounding.
        if not 0 <= first < last <= clip.num_frames + 1:
            seconds = clip.num_frames / clip.fps
            raise UserError(f"{self.span[0]:g} to {self.span[1]:g} s is no part of a motion of {seconds:.2f} s")
        return clip.from_frame(first, last)

    def all_captions(self, positions: Float[np.ndarray, "T 22 3"], *, frozen: bool) -> tuple[Caption, ...]:
        """Returns captions of the action, if it has words, and those of the table; if `frozen`, the latter alone.

        Raises:
            UserError: There are none.
        """
        written: tuple[Caption, ...] = ()
        if not frozen and self.action in load_wordings().contents:
            facts = measure(positions, fps=HUMANML3D.fps)
            written = write_captions(self.name, Labels(self.action, STYLE), facts)
        if not (written or self.captions):
            why = "there is no caption" if frozen else f"there are no words for the action {self.action!r}"
            raise UserError(f"{why}; write a caption into the table")
        return tuple(dict.fromkeys((*self.captions, *written)))


def has_parts(table: CaptionTable) -> bool:
    """Returns whether the rows of a table are clips, and not captions of whole files."""
    return ACTION in table.columns


def find_parts(motion: Source, name: str, rows: Sequence[CaptionEntry]) -> list[TablePart]:
    """Returns the parts of a motion in their order. A motion of several parts numbers them from 1.

    Args:
        motion: For error messages.
        name: That of a clip of the whole motion.
        rows: Its rows.

    Raises:
        UserError: There are none, one has a problem, or rows of one part contradict each other.
    """
    if not rows:
        raise UserError(f"{motion}: is not in the table")
    spans = defaultdict(list)
    for row in rows:
        if row.problem:
            raise UserError(row.problem)
        spans[row.span].append(row)
    numbered = len(spans) > 1
    return [
        _make_part(f"{name}_{number}" if numbered else name, spans[span])
        for number, span in enumerate(sorted(spans), start=1)
    ]


def check_digest(path: Path, rows: Iterable[CaptionEntry]) -> None:
    """Raises `UserError` if a motion file is not the one whose SHA-256 its rows begin with."""
    wanted = {row.cells.get(DIGEST, "") for row in rows} - {""}
    found = hashlib.sha256(load_bytes(path)).hexdigest() if wanted else ""
    for digits in sorted(wanted):
        if not found.startswith(digits.lower()):
            raise UserError(f"{path}: SHA-256 {found[: len(digits)]}, not {digits} as in the table; get the same file")


def _make_part(name: str, rows: list[CaptionEntry]) -> TablePart:
    """Returns the part that some rows describe."""
    known: dict[str, str] = {}
    for column in (ACTION, PERSON, SPLIT):
        values = {row.cells.get(column, "") for row in rows}
        if len(values) > 1:
            raise UserError(f"{rows[1].place}: rows of one clip have the {column} {' and '.join(sorted(values))}")
        known[column] = values.pop()
    if known[SPLIT] not in ("", *SPLITS):
        raise UserError(f"{rows[0].place}: split {known[SPLIT]!r} is not {', '.join(SPLITS)}")
    # The part is the whole clip now.
    captions = [caption._replace(start=0.0, end=0.0) for row in rows for caption in row.captions]
    own = tuple(dict.fromkeys(captions))
    return TablePart(name, own, rows[0].span, action=known[ACTION], person=known[PERSON], split=known[SPLIT])
