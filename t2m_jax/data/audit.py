"""Checking a data-set folder: counts of its contents, and everything that would disturb training or evaluation."""

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from t2m_jax.data.banks.captions import caption_tokens
from t2m_jax.data.body_checks import check_copies, check_twin
from t2m_jax.data.cache import cache_places, damage, scan_sources
from t2m_jax.data.caption_checks import check_speeds, check_twin_captions
from t2m_jax.data.checks import check_overlap, check_rate, compare_statistics
from t2m_jax.data.clip_audit import AuditedClip, audit_clip
from t2m_jax.data.files import FEATURES, INFO, MIRROR_PREFIX, POSITIONS, SPLITS, TEXTS
from t2m_jax.data.folder import Dataset, DatasetInfo, open_dataset
from t2m_jax.data.index import load_index
from t2m_jax.data.texts import Caption
from t2m_jax.errors import UserError
from t2m_jax.files.manifest import MANIFEST, changes, has_manifest
from t2m_jax.motion.normalizer import normalizer_from_clips
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.text.word_vectors import MAX_WORDS, MIN_COUNT, UNKNOWN, vocabulary_from_captions

STATISTICS_TOLERANCE = 0.05
"""Allowed difference of the statistics, in standard deviations. HumanML3D's published statistics were summed in single
precision, which costs up to 0.4 %."""
MANY_MISSING = 20
"""If more files are missing, they are counted; otherwise each one is named."""
HUMANML3D_PAGE = "https://github.com/EricGuo5513/HumanML3D"


@dataclasses.dataclass(frozen=True, kw_only=True)
class SplitCounts:
    """The contents of one split."""

    clips: int
    """Names in its list."""
    mirrored: int
    """Mirrored twins among them."""
    frames: int
    """Frames of its readable clips."""
    hours: float
    """Duration of these clips."""
    captions: int
    """Captions of its clips."""
    shortest: int
    """Frames of its shortest clip."""
    longest: int
    """Frames of its longest clip."""
    out_of_range: int
    """Clips that are too short or too long to be learned whole (see `DatasetInfo.fits`)."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class AuditReport:
    """The result of an audit; `dataclasses.asdict` makes it JSON."""

    folder: str
    """Path of the data set."""
    name: str
    """Name of the data set."""
    skeleton: str
    """Name of its skeleton."""
    fps: float
    """Frames per second."""
    splits: dict[str, SplitCounts]
    """Counts by split."""
    problems: list[str]
    """Faults that should be repaired, one line each, which names the file."""
    notes: list[str]
    """Information that is not about a fault."""


def missing_files(dataset: Dataset, names: Iterable[str]) -> tuple[str, set[str]]:
    """Returns a line about clips without features or captions, if they are many, and the names of these clips.

    The line says where the files of HumanML3D come from, which may not be passed on complete.
    """
    lost = {
        kind: [name for name in names if not (dataset.folder / folder / f"{name}{suffix}").exists()]
        for kind, folder, suffix in (("motions", FEATURES, ".npy"), ("captions", TEXTS, ".txt"))
    }
    told = {kind: missing for kind, missing in lost.items() if len(missing) > MANY_MISSING}
    if not told:
        return "", set()
    counts = " and ".join(f"{len(missing):,} {kind}" for kind, missing in told.items())
    # Importers always write this file.
    published = not (dataset.folder / INFO).exists()
    where = f"{HUMANML3D_PAGE} says how to make or get them" if published else "import again"
    return f"{counts} missing (such as {next(iter(told.values()))[0]}); {where}", set().union(*told.values())


def check_clips_together(
    clips: Mapping[str, AuditedClip], splits: Mapping[str, Iterable[str]], skeleton: Skeleton
) -> list[str]:
    """Returns twins that are not mirrored, motions that two splits have, and captions that fit other clips."""
    bodies = {name: clip.body for name, clip in clips.items() if clip.body is not None}
    captions = {name: clip.captions for name, clip in clips.items()}
    problems = []
    for name, body in bodies.items():
        original = bodies.get(name[len(MIRROR_PREFIX) :]) if name.startswith(MIRROR_PREFIX) else None
        if original is not None:
            problems += [f"{FEATURES}/{name}.npy: {problem}" for problem in check_twin(original, body, skeleton)]
            problems += [f"{TEXTS}/{name}.txt: {problem}" for problem in check_twin_captions(name, captions)]
    homes = {name: split for split, names in splits.items() for name in names}
    return problems + check_copies(bodies, homes) + check_speeds(captions, bodies)


def check_stored_statistics(dataset: Dataset, splits: dict[str, tuple[str, ...]]) -> list[str]:
    """Returns the faults of `Mean.npy` and `Std.npy`, which must describe the training clips or all clips."""
    try:
        stored = dataset.normalizer
    except UserError as error:
        return [str(error)]

    def readable(names: Iterable[str]) -> Iterator[Float[np.ndarray, "T D"]]:
        for name in names:
            try:
                yield dataset.features(name)
            except UserError:  # reported with the clip
                continue

    differences = []
    # Importers measure the training clips, and HumanML3D's authors measured all clips.
    for names in (splits.get("train", ()), tuple(itertools.chain(*splits.values()))):
        try:
            measured = normalizer_from_clips(readable(names), dataset.skeleton.layout)
        except UserError:  # there are no readable clips, which is reported with the clips
            continue
        differences.append(max(compare_statistics(stored, measured)))
        if differences[-1] <= STATISTICS_TOLERANCE:
            return []
    if not differences:
        return []
    difference = f"differ from the clips by {min(differences):.2f} of their spread"
    return [f"Mean.npy, Std.npy: {difference}; delete both and import again, which computes them"]


def check_manifest(folder: Path) -> list[str]:
    """Returns the files that have changed since an import, a merge or a composition wrote the folder.

    Data sets of others, which have no manifest, are not compared. That a file of a clip is missing is said elsewhere.
    """
    if not has_manifest(folder):
        return []
    hint = f"if it was on purpose, delete {MANIFEST}; otherwise import again"
    try:
        found = changes(folder, thorough=True)
        lines = [line for name, line in found if "/" not in name or (folder / name).exists()]
    except UserError as error:
        lines = [str(error).partition(";")[0]]
    if len(lines) > MANY_MISSING:
        return [f"{len(lines):,} files have changed since they were written, such as {lines[0]}; {hint}"]
    return [f"{line}; {hint}" for line in lines]


def _check_folder(dataset: Dataset, names: set[str]) -> list[str]:
    """Returns changed files, those of clips that are in no list, and caches that are damaged or of other contents."""
    problems = check_manifest(dataset.folder)
    for folder, suffix in ((FEATURES, ".npy"), (POSITIONS, ".npy"), (TEXTS, ".txt")):
        orphans = sorted({path.stem for path in (dataset.folder / folder).glob(f"*{suffix}")} - names)
        if orphans:
            problems.append(f"{folder}: {len(orphans)} files of clips in no split list, such as {orphans[0]}{suffix}")
    sources = scan_sources(dataset.folder, feature_dim=dataset.skeleton.feature_dim)
    for place in cache_places(dataset.folder):
        problem = damage(place, dataset.folder, sources) if place.exists() else ""
        if problem:
            problems.append(f"{place}: {problem}; delete it, and it will be rebuilt")
    return problems


def recording_notes(dataset: Dataset, splits: dict[str, tuple[str, ...]]) -> list[str]:
    """Returns notes about clips that share a recording with training clips, by the table `index.csv`.

    Raises:
        UserError: The table cannot be read.
    """
    index = load_index(dataset.folder)
    shared = {
        split: len(index.recorded_with(names, splits.get("train", ())))
        for split, names in splits.items()
        if index and split != "train"
    }
    told = "clips are cut from recordings that are in train, too; protocol strict leaves them out"
    return [f"{count} of {len(splits[split])} {split} {told}" for split, count in shared.items() if count]


def caption_notes(captions: Mapping[str, Sequence[Caption]], *, training: Iterable[str]) -> list[str]:
    """Returns notes about captions that an evaluator trained on the data reads only in part or not at all.

    Args:
        captions: All captions of each clip.
        training: Clips whose captions make the vocabulary.
    """
    tokens = {name: [caption_tokens(caption) for caption in found] for name, found in captions.items()}
    # The vocabulary of an evaluator that is trained on this data.
    learned = (words for name in training for words in tokens.get(name, ()))
    vocabulary = vocabulary_from_captions(learned, min_count=MIN_COUNT)
    long = []
    unknown = []
    for name, captions_tokens in tokens.items():
        for found in captions_tokens:
            words = {token.partition("/")[0] for token in found} - {UNKNOWN}
            long += [name] * (len(found) > MAX_WORDS)
            unknown += [name] * (not any(word in vocabulary for word in words))
    notes = {
        "clips have no caption that can be read, and nothing that reads captions uses them (such as {})": [
            name for name, found in tokens.items() if not found
        ],
        f"captions have more than {MAX_WORDS} words, of which an evaluator reads the first {MAX_WORDS} "
        "(such as one of {})": long,
        f"captions have no word that training captions use {MIN_COUNT} times; an evaluator of this data knows none of "
        "their words (such as one of {})": unknown,
    }
    return [f"{len(names)} {note.format(names[0])}" for note, names in notes.items() if names]


def _count_clips(clips: Mapping[str, AuditedClip], info: DatasetInfo) -> SplitCounts:
    """Returns the counts of a split from its clips."""
    frames = [clip.num_frames for clip in clips.values()]
    return SplitCounts(
        clips=len(frames),
        mirrored=sum(name.startswith(MIRROR_PREFIX) for name in clips),
        frames=sum(frames),
        hours=round(sum(frames) / info.fps / 3600, 4),
        captions=sum(len(clip.captions) for clip in clips.values()),
        shortest=min(frames, default=0),
        longest=max(frames, default=0),
        out_of_range=sum(not info.fits(length) for length in frames),
    )


def audit_dataset(folder: str | Path) -> AuditReport:
    """Returns counts of a data-set folder and everything that is wrong with it.

    Raises:
        UserError: The folder is not a data set.
    """
    dataset = open_dataset(folder)
    info = dataset.info
    splits: dict[str, tuple[str, ...]] = {}
    counts: dict[str, SplitCounts] = {}
    problems: list[str] = []
    for split in SPLITS:
        try:
            splits[split] = dataset.names(split)
        except UserError as error:
            problems.append(str(error))
    line, absent = missing_files(dataset, list(itertools.chain(*splits.values())))
    problems += [line] * bool(line)
    clips: dict[str, AuditedClip] = {}
    for split, names in splits.items():
        found = {name: audit_clip(dataset, name) for name in names if name not in absent}
        clips |= found
        counts[split] = _count_clips(found, info)
    problems += itertools.chain.from_iterable(clip.problems for clip in clips.values())
    problems += check_overlap(splits) + check_rate(info, dataset.skeleton) + check_stored_statistics(dataset, splits)
    problems += check_clips_together(clips, splits, dataset.skeleton)
    problems += _check_folder(dataset, set(itertools.chain(*splits.values())))
    captions = {name: clip.captions for name, clip in clips.items()}
    outside = sum(count.out_of_range for count in counts.values())
    notes = [f"{outside} clips outside {info.min_frames} to {info.max_frames} frames"] * bool(outside)
    notes += caption_notes(captions, training=splits.get("train", ()))
    try:
        notes += recording_notes(dataset, splits)
    except UserError as error:
        problems.append(str(error))
    return AuditReport(
        folder=str(folder),
        name=info.name,
        skeleton=info.skeleton,
        fps=info.fps,
        splits=counts,
        problems=problems,
        notes=notes,
    )
