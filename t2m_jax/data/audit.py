"""Checking a data-set folder: what is in it, and everything that training or evaluation would stumble over."""

import dataclasses
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from t2m_jax.data.cache import cache_places, damage, scan_sources
from t2m_jax.data.caption_notes import caption_notes
from t2m_jax.data.files import FEATURES, MIRROR_PREFIX, POSITIONS, SPLITS, TEXTS, load_array
from t2m_jax.data.folder import Dataset, open_dataset
from t2m_jax.data.index import load_index
from t2m_jax.data.texts import Caption, read_captions
from t2m_jax.errors import UserError
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.normalizer import Normalizer, normalizer_from_clips

MAX_JOINT_SPEED = 30.0
"""metres a second: faster than any limb moves"""
FLOOR_RANGE = (-0.1, 0.5)
"""metres: where the lowest joint of a whole clip may be"""
STATISTICS_TOLERANCE = 0.05
"""of a standard deviation: HumanML3D's published statistics were summed in single precision, which costs up to 0.4 %"""
QUOTED = 60
"""characters of a caption that a message repeats"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SplitCounts:
    """What one split holds."""

    clips: int
    """Names in its list."""
    mirrored: int
    """Mirrored twins among them."""
    frames: int
    """Feature rows of its readable clips."""
    hours: float
    """Their duration."""
    captions: int
    """Captions of its clips."""
    shortest: int
    """Feature rows of its shortest clip."""
    longest: int
    """Feature rows of its longest clip."""
    out_of_range: int
    """Clips shorter than the data set's `min_frames` or longer than its `max_frames`: kept on disk, skipped or cut
    in training."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class AuditReport:
    """The result of an audit; `dataclasses.asdict` makes it JSON."""

    folder: str
    """The data set."""
    name: str
    """What it calls itself."""
    skeleton: str
    """Its skeleton."""
    fps: float
    """Frames a second."""
    splits: dict[str, SplitCounts]
    """Counts by split."""
    problems: list[str]
    """What should be mended, one line each, naming the file; empty when all is fine."""
    notes: list[str]
    """What is worth knowing and no fault."""


def check_features(features: Float[np.ndarray, "T D"], dataset: Dataset) -> list[str]:
    """Returns what is wrong with the features of one clip."""
    if not np.all(np.isfinite(features)):
        return [f"holds {int(np.sum(~np.isfinite(features)))} values that are NaN or infinite"]
    if len(features) < 2:
        return [f"has {len(features)} frames"]
    metres = positions_from_features(features, dataset.skeleton) * dataset.skeleton.metres_per_unit
    if not np.all(np.isfinite(metres)):
        return ["decodes to positions that are not finite"]
    problems = []
    speed = float(np.linalg.norm(np.diff(metres, axis=0), axis=-1).max()) * dataset.info.fps
    if speed > MAX_JOINT_SPEED:
        problems.append(f"a joint moves at {speed:.0f} m/s; frames are missing or the unit is wrong")
    lowest = float(metres[..., 1].min())
    if not FLOOR_RANGE[0] <= lowest <= FLOOR_RANGE[1]:
        problems.append(f"its lowest joint is at {lowest:.2f} m, not on the floor")
    return problems


def check_captions(captions: Iterable[Caption], *, seconds: float) -> list[str]:
    """Returns what is wrong with the captions of one clip that lasts `seconds`."""
    captions = tuple(captions)
    problems = [] if captions else ["has no caption"]
    for caption in captions:
        said = f"caption '{caption.text[:QUOTED]}{'...' * (len(caption.text) > QUOTED)}'"
        if not caption.tokens:
            problems.append(f"{said} has no word/POS tokens")
        elif any(token.count("/") != 1 or not all(token.split("/")) for token in caption.tokens):
            problems.append(f"{said} has a token that is no word/POS")
        if not 0.0 <= caption.start <= caption.end:
            problems.append(f"{said} has times {caption.start} to {caption.end}")
        elif caption.end > seconds + 0.5:
            problems.append(f"{said} ends at {caption.end} s, the clip at {seconds:.2f} s")
    return problems


def _check_clip(dataset: Dataset, name: str) -> tuple[list[str], int, tuple[Caption, ...]]:
    """Returns the problems of one clip, its number of rows (0 if unreadable) and its captions."""
    problems, frames, captions = [], 0, tuple[Caption, ...]()
    try:
        features = dataset.features(name)
        frames = len(features)
        problems += [f"{FEATURES}/{name}.npy: {problem}" for problem in check_features(features, dataset)]
    except UserError as error:
        problems.append(str(error))
    try:
        captions, broken = read_captions(dataset.folder / TEXTS / f"{name}.txt")
        problems += broken
        seconds = frames / dataset.info.fps
        if captions or not broken:
            problems += [f"{TEXTS}/{name}.txt: {problem}" for problem in check_captions(captions, seconds=seconds)]
    except UserError as error:
        problems.append(str(error))
    return problems, frames, captions


def _count_split(dataset: Dataset, lengths: dict[str, int], captions: int) -> SplitCounts:
    """Returns the counts of a split from the lengths of its clips."""
    info, rows = dataset.info, list(lengths.values())
    return SplitCounts(
        clips=len(rows),
        mirrored=sum(name.startswith(MIRROR_PREFIX) for name in lengths),
        frames=sum(rows),
        hours=round(sum(rows) / info.fps / 3600, 4),
        captions=captions,
        shortest=min(rows, default=0),
        longest=max(rows, default=0),
        out_of_range=sum(not info.min_frames <= length <= info.max_frames for length in rows),
    )


def check_overlap(splits: dict[str, tuple[str, ...]]) -> list[str]:
    """Returns clips that stand in two lists or twice in one; a clip and its mirrored twin count as one."""
    problems = []
    home: dict[str, str] = {}
    for split, names in splits.items():
        problems += [f"{split}.txt: names {name} {count} times" for name, count in Counter(names).items() if count > 1]
        for original in sorted({name.removeprefix(MIRROR_PREFIX) for name in names}):
            if original in home:
                problems.append(f"{split}.txt: {original} or its mirrored twin is in {home[original]}.txt, too")
            home.setdefault(original, split)
    return problems


def _deviation(stored: Normalizer, computed: Normalizer) -> float:
    """Returns by how much two statistics differ, in standard deviations."""
    scale = np.maximum(np.asarray(computed.std), 1e-8)
    mean = np.abs(np.asarray(stored.mean) - np.asarray(computed.mean)) / scale
    return float(max(mean.max(), np.abs(np.asarray(stored.std) / scale - 1).max()))


def check_statistics(dataset: Dataset, splits: dict[str, tuple[str, ...]]) -> list[str]:
    """Returns what is wrong with `Mean.npy` and `Std.npy`: they must be those of the training clips or of all clips."""
    try:
        stored = dataset.normalizer
    except UserError as error:
        return [str(error)]

    def readable(names: Iterable[str]) -> Iterable[Float[np.ndarray, "T D"]]:
        for name in names:
            try:
                yield dataset.features(name)
            except UserError:  # reported with the clip
                continue

    everything = [name for names in splits.values() for name in names]
    deviations = []
    for names in (splits.get("train", ()), everything):
        if not names:
            continue
        deviations.append(_deviation(stored, normalizer_from_clips(readable(names), dataset.skeleton.layout)))
        if deviations[-1] <= STATISTICS_TOLERANCE:
            return []
    if not deviations:
        return []
    return [
        f"Mean.npy, Std.npy: differ from the clips' statistics by {min(deviations):.2f} of their spread; import again"
    ]


def _find_orphans(dataset: Dataset, names: set[str]) -> list[str]:
    """Returns one line for each folder with files that no list names."""
    problems = []
    for folder, suffix in ((FEATURES, ".npy"), (POSITIONS, ".npy"), (TEXTS, ".txt")):
        orphans = sorted({path.stem for path in (dataset.folder / folder).glob(f"*{suffix}")} - names)
        if orphans:
            problems.append(f"{folder}: {len(orphans)} files of clips in no split list, such as {orphans[0]}{suffix}")
    return problems


def _check_positions(dataset: Dataset, names: Iterable[str]) -> list[str]:
    """Returns clips whose file of positions, if there, has another shape than the skeleton's."""
    problems = []
    for name in names:
        path = dataset.folder / POSITIONS / f"{name}.npy"
        if not path.exists():
            continue
        try:
            shape = load_array(path, mmap=True).shape
        except UserError as error:
            problems.append(str(error))
            continue
        if len(shape) != 3 or shape[1:] != (dataset.skeleton.num_joints, 3):
            problems.append(
                f"{POSITIONS}/{name}.npy: has shape {shape}, expected T x {dataset.skeleton.num_joints} x 3"
            )
    return problems


def _check_cache(dataset: Dataset) -> list[str]:
    """Returns where the cache of the clips, if there is one, is damaged; reading samples it, this reads all of it."""
    sources = scan_sources(dataset.folder, feature_dim=dataset.skeleton.feature_dim)
    problems = []
    for place in cache_places(dataset.folder):
        problem = damage(place, sources) if place.exists() else ""
        if problem:
            problems.append(f"{place}: {problem}; delete it, it is made anew from the data set")
    return problems


def _check_index(dataset: Dataset, splits: dict[str, tuple[str, ...]]) -> tuple[list[str], list[str]]:
    """Returns problems of `index.csv`, and notes on clips that share a recording with training."""
    try:
        index = load_index(dataset.folder)
    except UserError as error:
        return [str(error)], []
    if index is None:
        return [], []
    notes = []
    for split in SPLITS[1:]:
        shared = len(index.recorded_with(splits.get(split, ()), splits.get("train", ())))
        if shared:
            said = f"of {len(splits[split])} {split} clips are cut from recordings that are in train, too"
            notes.append(f"{shared} {said}; protocol strict leaves them out")
    return [], notes


def audit_dataset(folder: str | Path) -> AuditReport:
    """Returns counts of a data-set folder and everything wrong with it.

    Raises:
        UserError: the folder is no data set at all.
    """
    dataset = open_dataset(folder)
    splits: dict[str, tuple[str, ...]] = {}
    problems: list[str] = []
    for split in SPLITS:
        try:
            splits[split] = dataset.names(split)
        except UserError as error:
            problems.append(str(error))
    counts: dict[str, SplitCounts] = {}
    captions: dict[str, tuple[Caption, ...]] = {}
    for split, names in splits.items():
        lengths = {}
        for name in names:
            found, lengths[name], captions[name] = _check_clip(dataset, name)
            problems += found
        counts[split] = _count_split(dataset, lengths, sum(len(captions[name]) for name in names))
    everything = {name for names in splits.values() for name in names}
    problems += check_overlap(splits) + check_statistics(dataset, splits)
    problems += _find_orphans(dataset, everything) + _check_positions(dataset, sorted(everything))
    problems += _check_cache(dataset)
    wrong, shared = _check_index(dataset, splits)
    problems += wrong
    info, outside = dataset.info, sum(count.out_of_range for count in counts.values())
    notes = [f"{outside} clips outside {info.min_frames} to {info.max_frames} frames"] if outside else []
    notes += caption_notes(captions, training=splits.get("train", ())) + shared
    return AuditReport(
        folder=str(folder),
        name=info.name,
        skeleton=info.skeleton,
        fps=info.fps,
        splits=counts,
        problems=problems,
        notes=notes,
    )
