"""Importing a folder of BVH, GLB, AMC and AMASS files, with captions from a table, text files or names."""

import dataclasses
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import tqdm
from jaxtyping import Float

from t2m_jax.config import load_config
from t2m_jax.data.folder import DatasetInfo, first_names
from t2m_jax.data.importers.caption_files import (
    Source,
    captions_within,
    clip_name,
    find_captions,
    find_table,
    is_named,
    unused_entries,
)
from t2m_jax.data.importers.caption_table import (
    DIGEST,
    OWN_COLUMNS,
    SPLIT,
    CaptionEntry,
    CaptionTable,
    find_entries,
)
from t2m_jax.data.importers.division import EIGHTY, Division
from t2m_jax.data.importers.motion_files import find_motion_files, open_motion_file
from t2m_jax.data.importers.table_parts import TablePart, check_digest, find_parts, has_parts
from t2m_jax.data.index import IndexEntry, save_index
from t2m_jax.data.writer import ImportReport, finish_folder, new_folder, with_twins, write_twins
from t2m_jax.errors import UserError, naming
from t2m_jax.motion.amc import AMC_FPS
from t2m_jax.motion.rig import RigClip
from t2m_jax.motion.rig.orientation import Up, rest_frames, sides_note
from t2m_jax.motion.rig.retarget import clip_up, find_rig, lying_note, retarget
from t2m_jax.motion.rig.rigs import Rig
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.motion.smpl import up_of_smpl


class _Prepared(NamedTuple):
    """A motion as it is written, and what was done to it."""

    positions: Float[np.ndarray, "T 22 3"]
    rig: str
    left_is_left: bool
    begin: float
    """Seconds that were cut before it."""
    steps: tuple[str, ...]
    """What the report says, each with the names of all clips of which it holds."""


def _prepare(motion: Source, clip: RigClip, *, rig: str | None, up: Up) -> _Prepared:
    """Returns the 22 joints of a clip at 20 frames per second with Y up, without a rest pose at the beginning."""
    table = find_rig(clip, rig)
    steps = [*clip.notes, *([table.note] if table.note else [])]
    if not table.was_tried:
        steps.append(f"rig {table.name}: its table is from documentation, never tried on a real file; see the sheet")
    if up == "auto":
        up = _find_up(motion.path, clip, table)
        steps += ["Z was up; turned"] if up == "z" else filter(None, [lying_note(clip, table)])
    # Before the resampling, whose filter would smooth the jump that tells a rest pose.
    rest = rest_frames(retarget(clip, rig=table, up=up).positions, fps=clip.fps)
    if rest:
        clip = clip.from_frame(rest)
        steps.append("a rest pose before the motion was cut")
    positions = retarget(clip.resampled(HUMANML3D.fps), rig=table, up=up).positions
    if len(positions) < 2:
        raise UserError(f"has only one frame at {HUMANML3D.fps:g} frames per second")
    exchanged = sides_note(positions)
    if exchanged:
        steps.append(f"{exchanged}; see the sheet")
    return _Prepared(positions, table.name, not exchanged, rest / clip.fps, tuple(steps))


def _find_up(path: Path, clip: RigClip, table: Rig) -> Literal["y", "z"]:
    """Returns the axis of a clip that points up."""
    suffix = path.suffix.lower()
    if suffix == ".glb":
        return "y"  # as glTF demands
    return up_of_smpl(clip) if suffix == ".npz" else clip_up(clip, table)


def _unread_columns(table: CaptionTable, split_by: str | None) -> list[str]:
    """Returns a line about the columns of a table that nothing is read from, if there are any."""
    read = {split_by, *(OWN_COLUMNS if has_parts(table) else (SPLIT, DIGEST))}
    unread = [repr(name) for name in table.columns if name not in read]
    return [f"columns that are not read: {', '.join(unread)}"] if unread else []


def _load_info(source: Path, info: str | Path | None) -> DatasetInfo:
    """Returns what is known of the data: from a file, or the folder's name."""
    if info is None:
        return DatasetInfo(name=source.resolve().name, min_frames=16, source=source.resolve().name)
    about = load_config(Path(info), DatasetInfo)
    if (about.skeleton, about.fps) != (HUMANML3D.name, HUMANML3D.fps):
        raise UserError(f"{info}: skeleton and fps are {HUMANML3D.name} and {HUMANML3D.fps:g} here; leave them out")
    return about


@dataclasses.dataclass(frozen=True, kw_only=True)
class BvhOptions:
    """How a folder of motion files is imported."""

    captions: str | Path | None = None
    """Table of files and captions (see `caption_table`); by default `captions.csv`, `.tsv` or `.txt` in the folder. An
    animation of a GLB file is called `file/animation`. A `.txt` next to a file of one motion is read, too, unless the
    table is `frozen` or has a column `action`: then each of its rows is a clip (see `table_parts`)."""
    rig: str | None = None
    """Name of a rig, or a YAML table such as `pelvis: Hips`; by default detected from the joint names."""
    caption_from_name: bool = False
    """A clip without captions gets the words of its file's or its animation's name."""
    info: str | Path | None = None
    """YAML file with the name, license, source and attribution of the data, as in `dataset.yaml`."""
    up: Up = "auto"
    """The axis that points up; by default the one along which the figure stands."""
    amc_fps: float = AMC_FPS
    """Frames per second of AMC files, which do not say it."""
    split: str | Path = EIGHTY
    """Shares of train, val and test, or a folder with lists of clip names (train.txt, val.txt, test.txt)."""
    split_by: str | None = None
    """Clips that have this in common stay in one split: `folder`, or a column of the table of captions."""
    seed: int = 0
    """Seed of the split."""
    twins: bool = True
    """Whether each clip gets a mirrored twin, with left and right exchanged in its captions if they are English."""
    frozen: bool = False
    """Import just what the table says: its captions alone, without sentences that are written for actions; if a file
    is missing or another one than the column `sha256` says, or a clip cannot be converted, nothing is imported."""


def _same_name(motion: Source | Path, name: str, other: Source | Path) -> UserError:
    return UserError(f"{motion}: would be named {name} like {other}; rename one of them")


@dataclasses.dataclass
class _Converter:
    """Writes clips, and remembers what was done to them."""

    source: Path
    table: CaptionTable
    division: Division
    options: BvhOptions
    motions: dict[str, Source] = dataclasses.field(default_factory=dict)
    """All motions by the names of their clips."""
    groups: dict[str, str] = dataclasses.field(default_factory=dict)
    """Names of the clips that were written -> their groups (see `Division`)."""
    left_out: dict[str, str] = dataclasses.field(default_factory=dict)
    """Clip name -> why it was not written."""
    steps: dict[str, list[str]] = dataclasses.field(default_factory=lambda: defaultdict(list))
    """What was done -> names of clips."""
    sides: dict[str, list[bool]] = dataclasses.field(default_factory=lambda: defaultdict(list))
    """Rig -> whether left is left, in each of its clips."""
    entries: list[IndexEntry] = dataclasses.field(default_factory=list)
    """Rows of `index.csv`, of clips with labels."""
    num_frames: int = 0

    def file(self, path: Path, folder: Path) -> None:
        """Writes the clips of a file."""
        try:
            motions = open_motion_file(path, amc_fps=self.options.amc_fps, rig=self.options.rig)
        except UserError as error:
            motion = Source(path, None)
            if not self.options.frozen or is_named(self.table, motion.keys(self.source)):
                self.left_out[self._add(motion)] = str(error)
            return
        for motion, clip in motions.items():
            rows = find_entries(self.table, motion.keys(self.source))
            if self.options.frozen and not rows:
                continue  # an archive has more than a table names
            try:
                parts = self._parts(motion, rows)
            except UserError as error:
                self.left_out[self._add(motion)] = str(error)
                continue
            for part in parts:
                self._add(motion, part.name)
                try:
                    self._write(motion, part, clip, folder)
                except UserError as error:
                    self.left_out[part.name] = str(error)

    def _parts(self, motion: Source, rows: Sequence[CaptionEntry]) -> list[TablePart]:
        """Returns the clips that a motion becomes: those of its rows of the table, or one with all of it.

        Raises:
            UserError: There are no captions, the table is wrong, or the file is another one.
        """
        check_digest(motion.path, rows)
        name = clip_name(motion.key(self.source))
        if has_parts(self.table):
            return find_parts(motion, name, rows)
        frozen = self.options.frozen
        from_name = self.options.caption_from_name and not frozen
        captions = find_captions(motion, rows, only_table=frozen, from_name=from_name)
        return [TablePart(name, captions)]

    def _write(self, motion: Source, part: TablePart, clip: RigClip, folder: Path) -> None:
        """Writes a clip and its twin.

        Raises:
            UserError: It has no captions or no split, or it cannot be converted.
        """
        group = self.division.group(motion, part)
        with naming(motion):
            ready = _prepare(motion, part.cut(clip), rig=self.options.rig, up=self.options.up)
            found = part.all_captions(ready.positions, frozen=self.options.frozen)
            said = captions_within(found, begin=ready.begin, seconds=len(ready.positions) / HUMANML3D.fps)
        if len(said) < len(found):
            self.steps["a caption about what the motion does not have was left out"].append(part.name)
        twins = self.options.twins
        frames = write_twins(folder, part.name, ready.positions, captions=said, skeleton=HUMANML3D, twins=twins)
        self.num_frames += frames * (1 + twins)
        self.groups[part.name] = group
        if has_parts(self.table):
            self.entries.append(IndexEntry(part.name, motion.key(self.source), part.label, person=part.person))
        self.sides[ready.rig].append(ready.left_is_left)
        for step in ready.steps:
            self.steps[step].append(part.name)

    def _add(self, motion: Source, name: str = "") -> str:
        """Returns the name of a motion's clip, which must be new."""
        name = name or clip_name(motion.key(self.source))
        # Different paths can become the same name, and one clip would replace the other.
        if name in self.motions:
            raise _same_name(motion, name, self.motions[name])
        self.motions[name] = motion
        return name

    def check_names(self, files: Sequence[Path]) -> None:
        """Raises `UserError` if two files of one motion each would become clips of one name."""
        names: dict[str, Path] = {}
        for path in () if has_parts(self.table) else files:
            if path.suffix.lower() != ".glb":  # animations are only known when their file is read
                name = clip_name(Source(path, None).key(self.source))
                if names.setdefault(name, path) != path:
                    raise _same_name(path, name, names[name])

    def check(self) -> None:
        """Raises `UserError` if there is no clip, or if a rig has left and right exchanged."""
        if len(self.left_out) == len(self.motions):
            first = next(iter(self.left_out.values()))
            raise UserError(f"{self.source}: none of {len(self.left_out)} clips could be imported; the first: {first}")
        for rig, sides in self.sides.items():
            wrong = len(sides) - sum(sides)
            # A single clip may be unclear; most clips of a rig are only wrong if its table is.
            if wrong > len(sides) / 2:
                raise UserError(
                    f"{self.source}: left and right are exchanged in {wrong} of {len(sides)} clips of rig {rig}, "
                    "as the knees bend and the feet point; correct the table of the rig"
                )

    def unused(self) -> list[str]:
        """Returns a line for each row of the table that gave no caption.

        Raises:
            UserError: The table is frozen, and a row gave no clip.
        """
        # What is wrong with a row is also why its clip was left out.
        told = set(self.left_out.values())
        lines = [line for line in unused_entries(self.table, self.motions.values(), self.source) if line not in told]
        if self.options.frozen and (lost := [*self.left_out.values(), *lines]):
            raise UserError(
                f"{self.options.captions}: {len(lost)} rows of the frozen table gave no clip; first: {lost[0]}"
            )
        return lines

    def notes(self) -> list[str]:
        """Returns a line for each thing that was done, with some clips."""
        return [f"{len(names)} clips: {step} ({first_names(names)})" for step, names in self.steps.items()]


def import_bvh_folder(source: str | Path, destination: str | Path, **options: Any) -> ImportReport:
    """Converts a folder of BVH, GLB, AMC and AMASS files into a new data-set folder and returns what was written.

    Clips are resampled to 20 frames per second, retargeted, encoded and mirrored. Each animation of a GLB file is a
    clip. A clip without a caption or with a broken file is left out, and the report names it, as it names all lines of
    a table that gave no caption.

    Args:
        source: Folder that is searched for `*.bvh`, `*.glb`, `*.amc` and `*.npz` of AMASS at any depth.
        destination: Folder to make.
        **options: Fields of `BvhOptions`.

    Raises:
        UserError: No clip can be imported, a table or `info` is broken, left and right are exchanged, the clips cannot
            be divided, or the destination exists.
    """
    source = Path(source)
    given = BvhOptions(**options)
    files = find_motion_files(source)
    about = _load_info(source, given.info)
    table = find_table(source, Path(given.captions) if given.captions else None, files=files)
    division = Division(given.split, given.split_by, source, table, given.seed)
    division.check()
    if given.frozen:  # animations are only known when their file is read
        files = [p for p in files if p.suffix.lower() == ".glb" or find_entries(table, Source(p, None).keys(source))]
        if not files:
            raise UserError(f"{source}: has no file of the table {given.captions}")
    convert = _Converter(source, table, division, given)
    convert.check_names(files)
    with new_folder(destination) as folder:
        for path in tqdm.tqdm(files, unit="file", desc="converting"):
            convert.file(path, folder)
        unused = convert.unused()
        convert.check()
        splits = division.divide(convert.groups)
        if given.twins:
            splits = {part: with_twins(members) for part, members in splits.items()}
        sizes = finish_folder(folder, splits, info=about, skeleton=HUMANML3D)
        if convert.entries:
            save_index(folder, convert.entries)
    found = (*_unread_columns(table, given.split_by), *division.absent(convert.motions))
    notes = (*table.notes, *found, *convert.notes(), *unused)
    return ImportReport(sum(sizes.values()), convert.num_frames, sizes, convert.left_out, notes)
