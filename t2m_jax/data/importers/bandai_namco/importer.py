"""Importing the Bandai-Namco-Research-Motiondataset (1 and 2): BVH files into a data-set folder with captions."""

import csv
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import tqdm

from t2m_jax.data.files import SPLITS, read_names
from t2m_jax.data.folder import DatasetInfo
from t2m_jax.data.importers.bandai_namco.captions import Labels, write_captions
from t2m_jax.data.importers.bandai_namco.measure import measure
from t2m_jax.data.importers.bandai_namco.wordings import load_wordings
from t2m_jax.data.index import IndexRow, save_index
from t2m_jax.data.splits import split_by_hash
from t2m_jax.data.writer import ImportReport, finish_folder, make_layout, new_folder, with_twins, write_twins
from t2m_jax.errors import UserError
from t2m_jax.motion.bvh import load_bvh
from t2m_jax.motion.bvh.resample import resample
from t2m_jax.motion.bvh.retarget import retarget
from t2m_jax.motion.skeleton import HUMANML3D

CLIP_TABLE = "bandai-namco-clips.csv"
HARMLESS_FLAG = "moving joint_Root"
MISLABELLED = (
    *(f"walk-turn-left_masculine_{number:03d}" for number in (6, 7)),
    *(f"walk-turn-right_masculine_{number:03d}" for number in (6, 7)),
)
"""clips of dataset-2 that turn to the other side than their name says"""
OVERLAPPING = (
    *(f"walk-turn-left_normal_{number:03d}" for number in (5, *range(27, 35))),
    *(f"walk-turn-right_normal_{number:03d}" for number in (4, *range(28, 36))),
)
"""clips of dataset-2 that share frames with another or run on into an extra turn"""
FLAGGED = frozenset(f"dataset-2_{name}" for name in (*MISLABELLED, *OVERLAPPING))

INFO = DatasetInfo(
    name="Bandai-Namco-Research-Motiondataset-1 and -2",
    skeleton=HUMANML3D.name,
    fps=HUMANML3D.fps,
    min_frames=16,
    max_frames=HUMANML3D.max_frames,
    licence="CC BY-NC 4.0",
    source="https://github.com/BandaiNamcoResearchInc/Bandai-Namco-Research-Motiondataset",
    attribution=(
        "Bandai-Namco-Research-Motiondataset-1 and -2, © 2022 Bandai Namco Research Inc., CC BY-NC 4.0, "
        "https://github.com/BandaiNamcoResearchInc/Bandai-Namco-Research-Motiondataset. Changed: resampled to 20 "
        "frames a second, retargeted to 22 joints, encoded as motion features, mirrored, captions added. "
        "Paper: M. Kobayashi, C.-C. Liao, K. Inoue, S. Yojima, M. Takahashi, Motion Capture Dataset for Practical Use "
        "of AI-based Motion Editing and Stylization, 2023, arXiv:2306.08861."
    ),
)


class _Job(NamedTuple):
    """One clip to convert."""

    source: Path
    folder: Path


class _Done(NamedTuple):
    """One clip that was converted."""

    name: str
    num_frames: int


def labels_from_name(name: str) -> Labels:
    """Returns content and style of a clip named `dataset-N_<content>_<style>_<number>`.

    Raises:
        UserError: the name has another form or an unknown label.
    """
    fields = name.split("_")
    if len(fields) != 4:
        raise UserError(f"{name}: expected a name like dataset-2_walk_active_001")
    labels = Labels(fields[1], fields[2])
    words = load_wordings()
    for kind, label, known in (("content", labels.content, words.contents), ("style", labels.style, words.styles)):
        if label not in known:
            raise UserError(f"{name}: unknown {kind} '{label}'; known are {', '.join(known)}")
    return labels


def find_clips(source: Path) -> dict[str, Path]:
    """Returns clip name -> BVH file, sorted by name, wherever below `source` the files lie.

    Raises:
        UserError: there are none.
    """
    files = {path.stem: path for path in sorted(source.rglob("dataset-*_*.bvh"))}
    if not files:
        raise UserError(
            f"{source}: no dataset-N_*.bvh below it; give the folder of the unpacked archive, "
            "which holds dataset/Bandai-Namco-Research-Motiondataset-*"
        )
    return dict(sorted(files.items()))


def flagged_clips(source: Path, splits: Path | None) -> tuple[frozenset[str], str]:
    """Returns the clips to leave out and where that is known from: a clip table near the data, or this module.

    Flagged are clips that contradict their label, run on into another motion or repeat frames of another clip.
    """
    near = [source, source.parent, *([splits, splits.parent, splits.parent.parent] if splits else [])]
    table = next((folder / CLIP_TABLE for folder in near if (folder / CLIP_TABLE).is_file()), None)
    if table is None:
        return FLAGGED, "the built-in list"
    with table.open(encoding="utf-8", newline="") as lines:
        rows = list(csv.DictReader(lines))
    if not rows or not {"name", "flags"} <= rows[0].keys():
        raise UserError(f"{table}: expected the columns name and flags")
    return frozenset(row["name"] for row in rows if row["flags"] not in ("", HARMLESS_FLAG)), str(table)


def _find_split_lists(source: Path, splits: Path | None) -> Path | None:
    """Returns the folder with train.txt, val.txt and test.txt: the given one, or one near the data, or None."""
    candidates = (
        [splits]
        if splits
        else [source, source / "splits", source.parent / "splits", source.parent / "splits/bandai-namco"]
    )
    found = next(
        (folder for folder in candidates if all((folder / f"{split}.txt").is_file() for split in SPLITS)), None
    )
    if splits and not found:
        raise UserError(f"{splits}: expected train.txt, val.txt and test.txt in it")
    return found


def _split_clips(names: Sequence[str], lists: Path | None) -> dict[str, list[str]]:
    """Returns split -> clips: by the published lists, or spread over contents and styles by hash."""
    if lists is None:
        cells: dict[Labels, list[str]] = {}
        for name in names:
            cells.setdefault(labels_from_name(name), []).append(name)
        return split_by_hash(cells.values())
    here = set(names)
    splits = {split: [name for name in read_names(lists / f"{split}.txt") if name in here] for split in SPLITS}
    if sum(map(len, splits.values())) != len(set().union(*splits.values())):
        raise UserError(f"{lists}: a clip stands in more than one of train.txt, val.txt and test.txt")
    if not splits["train"]:
        raise UserError(
            f"{lists / 'train.txt'}: names none of the clips that were found; is it the list of another data set?"
        )
    return splits


def _index_row(file: Path, source: Path) -> IndexRow:
    """Returns what the index tells of a clip: every file is a recording of its own."""
    labels = labels_from_name(file.stem)
    return IndexRow(file.stem, file.relative_to(source).as_posix(), f"{labels.content}, {labels.style}")


def _convert(job: _Job) -> _Done:
    """Returns the length of a clip after writing it and its mirrored twin."""
    name = job.source.stem
    labels = labels_from_name(name)
    motion = retarget(resample(load_bvh(job.source), HUMANML3D.fps), rig="bandai-namco")
    captions = write_captions(name, labels, measure(motion.positions, fps=motion.fps))
    return _Done(name, write_twins(job.folder, name, motion.positions, captions=captions, skeleton=HUMANML3D))


def _convert_all(jobs: Sequence[_Job], *, workers: int) -> Iterator[_Done]:
    """Yields converted clips in the order of the jobs."""
    if workers == 1:
        yield from map(_convert, jobs)
        return
    # Fresh interpreters: forking a process in which JAX runs its threads may hang.
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield from pool.imap(_convert, jobs, chunksize=8)


def import_bandai_namco(
    source: str | Path, destination: str | Path, *, splits: str | Path | None = None, workers: int | None = None
) -> ImportReport:
    """Returns what was written after converting the whole archive into a new data-set folder.

    Every clip is resampled to 20 frames a second, retargeted to the 22 joints, encoded, mirrored and captioned. Flagged
    clips are left out. Scripts that call this with several workers need the usual `if __name__ == "__main__":`.

    Args:
        source: folder of the unpacked archive.
        destination: folder to make.
        splits: folder with train.txt, val.txt, test.txt (clip names); looked for near the data when not given. Without
            lists the split is 80/5/15 % by a hash of the names, within every content and style.
        workers: processes; as many as there are processors when not given.

    Raises:
        UserError: no clips, a broken BVH file, wrong lists, or a destination that exists.
    """
    source, destination = Path(source), Path(destination)
    files = find_clips(source)
    lists = _find_split_lists(source, Path(splits) if splits else None)
    flagged, flags_from = flagged_clips(source, lists)
    names = [name for name in files if name not in flagged]
    divided = _split_clips(names, lists)
    wanted = sorted(name for members in divided.values() for name in members)
    left_out = {name: f"flagged in {flags_from}" for name in files if name in flagged}
    left_out |= dict.fromkeys(sorted(set(names) - set(wanted)), f"in no list of {lists}")
    workers = min(workers or os.cpu_count() or 1, max(1, len(wanted) // 16))
    frames = 0
    with new_folder(destination) as folder:
        make_layout(folder)
        done = _convert_all([_Job(files[name], folder) for name in wanted], workers=workers)
        for clip in tqdm.tqdm(done, total=len(wanted), unit="clip", desc="converting"):
            frames += 2 * clip.num_frames
        twins = {split: with_twins(members) for split, members in divided.items()}
        sizes = finish_folder(folder, twins, info=INFO, skeleton=HUMANML3D)
        save_index(folder, (_index_row(files[name], source) for name in wanted))
    origin = (
        f"split lists: {lists}"
        if lists
        else "no split lists found: split by a hash of the names, 80/5/15 % of every content and style"
    )
    notes = (origin, f"{sum(name in flagged for name in files)} flagged clips left out (by {flags_from})")
    return ImportReport(2 * len(wanted), frames, sizes, left_out, notes)
