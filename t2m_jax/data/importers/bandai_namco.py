"""Importing the Bandai-Namco-Research-Motiondataset (1 and 2): BVH files into a data-set folder with captions."""

import functools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import tqdm

from t2m_jax.data.captioning.captions import Labels, write_captions
from t2m_jax.data.captioning.wordings import load_wordings
from t2m_jax.data.composing.compose import still_labels, write_composition
from t2m_jax.data.composing.extra import NewClip, write_more_captions, write_slow_clips, write_stand_clips
from t2m_jax.data.composing.pieces import make_library
from t2m_jax.data.files import SPLITS, read_names
from t2m_jax.data.folder import DatasetInfo
from t2m_jax.data.index import IndexEntry, save_index
from t2m_jax.data.splits import split_by_hash
from t2m_jax.data.workers import Mapper, map_in_processes
from t2m_jax.data.writer import ImportReport, check_count, finish_folder, new_folder, with_twins, write_twins
from t2m_jax.errors import UserError
from t2m_jax.motion.bvh import load_bvh
from t2m_jax.motion.facts import measure
from t2m_jax.motion.rig.retarget import retarget
from t2m_jax.motion.skeleton import HUMANML3D

MISLABELED = (
    *(f"walk-turn-left_masculine_{number:03d}" for number in (6, 7)),
    *(f"walk-turn-right_masculine_{number:03d}" for number in (6, 7)),
)
"""Clips of dataset-2 that turn to the other side than their name says."""
OVERLAPPING = (
    *(f"walk-turn-left_normal_{number:03d}" for number in (5, *range(27, 35))),
    *(f"walk-turn-right_normal_{number:03d}" for number in (4, *range(28, 36))),
)
"""Clips of dataset-2 that share frames with another clip or continue into another turn."""
FLAGGED = frozenset(f"dataset-2_{name}" for name in (*MISLABELED, *OVERLAPPING))
"""Clips that are left out."""

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
NO_LISTS = "no split lists found: split by a hash of the names, 80/5/15 % of every content and style"


def labels_from_name(name: str) -> Labels:
    """Returns content and style of a clip named `dataset-N_<content>_<style>_<number>`.

    Raises:
        UserError: The name has another form or an unknown label.
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
    """Returns clip name -> BVH file for all files below `source`, sorted by name.

    Raises:
        UserError: There are none.
    """
    paths = sorted(source.rglob("dataset-*_*.bvh"), key=lambda path: (path.stem, path))
    if not paths:
        raise UserError(
            f"{source}: no dataset-N_*.bvh below it; give the folder of the unpacked archive, "
            "which has dataset/Bandai-Namco-Research-Motiondataset-*"
        )
    return {path.stem: path for path in paths}


def _divide_clips(names: Sequence[str], lists: Path | None) -> dict[str, list[str]]:
    """Returns split -> clips: from the lists in a folder or, without them, by hash within every content and style.

    Raises:
        UserError: A clip is in several lists, or none is in the training list.
    """
    if lists is None:
        # Within each content and style, so that the test split has all of them.
        cells: dict[Labels, list[str]] = {}
        for name in names:
            cells.setdefault(labels_from_name(name), []).append(name)
        return split_by_hash(cells.values())
    known = set(names)
    splits = {split: [name for name in read_names(lists / f"{split}.txt") if name in known] for split in SPLITS}
    if sum(map(len, splits.values())) != len(set().union(*splits.values())):
        raise UserError(f"{lists}: a clip is in more than one of train.txt, val.txt and test.txt")
    if not splits["train"]:
        raise UserError(f"{lists / 'train.txt'}: names none of the clips; is it the list of another data set?")
    return splits


def _convert(file: Path, *, folder: Path) -> int:
    """Writes a clip and its mirrored twin and returns the number of feature rows of each."""
    motion = retarget(load_bvh(file).resampled(HUMANML3D.fps), rig="bandai-namco")
    captions = write_captions(file.stem, labels_from_name(file.stem), measure(motion.positions, fps=motion.fps))
    return write_twins(folder, file.stem, motion.positions, captions=captions, skeleton=HUMANML3D)


def _find_lists(source: Path, splits: str | Path | None) -> Path | None:
    """Returns the folder with the split lists, the given one or one near the data; None if there is none.

    Raises:
        UserError: The given folder does not have the lists.
    """
    near = (source, source / "splits", source.parent / "splits", source.parent / "splits/bandai-namco")
    for lists in [Path(splits)] if splits else near:
        if all((lists / f"{split}.txt").is_file() for split in SPLITS):
            return lists
    if splits:
        raise UserError(f"{splits}: expected train.txt, val.txt and test.txt in it")
    return None


def _write_new_clips(folder: Path, labels: Mapping[str, Labels], composed: int, run_all: Mapper) -> list[NewClip]:
    """Writes motions that are made of training clips, and returns them."""
    still = write_stand_clips(folder, labels)
    slow = write_slow_clips(folder, labels)
    library = make_library(folder, {**labels, **still_labels(still)}, weights={}, reach=float("inf"))
    made = run_all(functools.partial(write_composition, "turns", library=library), range(composed))
    return [*slow, *still, *tqdm.tqdm(made, total=composed, unit="clip", desc="composing")]


def import_bandai_namco(
    source: str | Path,
    destination: str | Path,
    *,
    splits: str | Path | None = None,
    composed: int = 0,
    workers: int | None = None,
) -> ImportReport:
    """Converts the whole archive into a new data-set folder and returns a report of what was written.

    Every clip is resampled to 20 frames per second, retargeted to the 22 joints, encoded, mirrored and captioned.
    Flagged clips are left out. Training clips get more captions: how fast they are among the clips of their content,
    and their style. Scripts that call this with several workers need `if __name__ == "__main__":`.

    Args:
        source: Folder of the unpacked archive.
        destination: Folder to make.
        splits: Folder with train.txt, val.txt and test.txt (clip names). By default, it is searched near the data.
            Without lists, clips are split 80/5/15 % by a hash of the names, within every content and style.
        composed: Number of motions to add for training that show two or three actions in turn. They are made of
            training clips. If it is above 0, very slow and still motions are added, too.
        workers: Number of processes; by default one per processor.

    Raises:
        UserError: There are no clips, a BVH file or a list is broken, `composed` is negative, no clips are short
            enough to be joined, or the destination exists.
    """
    check_count("composed", composed, least=0)
    source = Path(source)
    files = find_clips(source)
    lists = _find_lists(source, splits)
    flagged = [name for name in files if name in FLAGGED]
    divided = _divide_clips([name for name in files if name not in FLAGGED], lists)
    labels = {name: labels_from_name(name) for name in sorted(name for names in divided.values() for name in names)}
    left_out = dict.fromkeys(flagged, "flagged in the built-in list")
    left_out |= dict.fromkeys(sorted(files.keys() - FLAGGED - labels.keys()), f"in no list of {lists}")
    workers = min(workers or os.cpu_count() or 1, max(1, len(labels) // 16))
    with new_folder(destination) as folder, map_in_processes(workers) as run_all:
        done = run_all(functools.partial(_convert, folder=folder), [files[name] for name in labels])
        frames = sum(tqdm.tqdm(done, total=len(labels), unit="clip", desc="converting"))
        training = {name: labels[name] for name in divided["train"]}
        write_more_captions(folder, training)
        new = _write_new_clips(folder, training, composed, run_all) if composed else []
        divided["train"] = [*divided["train"], *(clip.name for clip in new)]
        twins = {split: with_twins(members) for split, members in divided.items()}
        sizes = finish_folder(folder, twins, info=INFO, skeleton=HUMANML3D)
        rows = [
            IndexEntry(name, files[name].relative_to(source).as_posix(), ", ".join(label))
            for name, label in labels.items()
        ]
        save_index(folder, [*rows, *(IndexEntry(clip.name, "", clip.label) for clip in new)])
    notes = [f"split lists: {lists}" if lists else NO_LISTS, f"{len(flagged)} flagged clips left out"]
    if new:
        notes.append(f"{len(new) - composed} very slow or still motions and {composed} composed ones added to train")
    frames += sum(clip.num_frames for clip in new)
    return ImportReport(2 * (len(labels) + len(new)), 2 * frames, sizes, left_out, tuple(notes))
