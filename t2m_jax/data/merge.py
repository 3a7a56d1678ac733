"""Putting several data sets into one folder."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from t2m_jax.data.files import FEATURES, MIRROR_PREFIX, POSITIONS, SPLITS, TEXTS
from t2m_jax.data.folder import Dataset, DatasetInfo, open_dataset
from t2m_jax.data.index import ClipIndex, IndexEntry, load_index, save_index
from t2m_jax.data.writer import ImportReport, finish_folder, new_folder
from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_array, reading
from t2m_jax.motion.features import positions_from_features


def merge_datasets(sources: Sequence[str | Path], destination: str | Path) -> ImportReport:
    """Writes one data-set folder with the clips, splits and labels of several, and returns a report.

    The statistics are those of all training clips. Licenses and attributions are listed one after another.

    Args:
        sources: Folders of data sets with the same skeleton.
        destination: Folder to make.

    Raises:
        UserError: Skeletons or frame rates differ, a clip's name is in two data sets, or a file cannot be copied.
    """
    datasets = [open_dataset(source) for source in sources]
    first = datasets[0]
    for other in datasets[1:]:
        if (other.skeleton, other.info.fps) != (first.skeleton, first.info.fps):
            raise UserError(f"{other.folder}: has another skeleton or frame rate than {first.folder}")
    splits: dict[str, list[str]] = {split: [] for split in SPLITS}
    owners: dict[str, Dataset] = {}
    for dataset in datasets:
        for split, names in read_splits(dataset).items():
            for name in names:
                if owners.setdefault(name, dataset) is not dataset:
                    raise UserError(f"{dataset.folder}: {name} is a clip of {owners[name].folder}, too; rename one")
            splits[split] += names
    with new_folder(destination) as folder:
        frames = sum(copy_clip(name, dataset, folder) for name, dataset in owners.items())
        sizes = finish_folder(folder, splits, info=_merged_info(datasets), skeleton=first.skeleton)
        owned = {dataset.folder: [name for name, owner in owners.items() if owner is dataset] for dataset in datasets}
        rows = [row for dataset in datasets for row in index_entries(dataset, owned[dataset.folder])]
        save_index(folder, rows)
    return ImportReport(len(owners), frames, sizes, {}, ())


def copy_clip(name: str, dataset: Dataset, folder: Path) -> int:
    """Copies the files of a clip, with positions that follow from its features if it has none; returns its frames."""
    positions = f"{POSITIONS}/{name}.npy"
    has_positions = (dataset.folder / positions).exists()
    for part in (f"{FEATURES}/{name}.npy", f"{TEXTS}/{name}.txt", *([positions] if has_positions else [])):
        with reading(dataset.folder / part):
            contents = (dataset.folder / part).read_bytes()
        (folder / part).write_bytes(contents)
    features = load_array(folder / FEATURES / f"{name}.npy", mmap=True)
    if not has_positions:
        np.save(folder / positions, positions_from_features(features, dataset.skeleton))
    return len(features)


def _merged_info(datasets: Sequence[Dataset]) -> DatasetInfo:
    infos = [dataset.info for dataset in datasets]

    def listed(texts: Iterable[str], separator: str) -> str:
        return separator.join(dict.fromkeys(filter(None, texts)))

    return DatasetInfo(
        name=listed((info.name for info in infos), " and "),
        skeleton=infos[0].skeleton,
        fps=infos[0].fps,
        min_frames=min(info.min_frames for info in infos),
        max_frames=max(info.max_frames for info in infos),
        licence=listed((info.licence for info in infos), "; "),
        source=listed((info.source for info in infos), "; "),
        attribution=listed((info.attribution for info in infos), " "),
    )


def read_splits(dataset: Dataset) -> dict[str, list[str]]:
    """Returns the clips of each split; none if a list is missing."""
    lists = {split: dataset.folder / f"{split}.txt" for split in SPLITS}
    return {split: list(dataset.names(split)) if path.exists() else [] for split, path in lists.items()}


def index_entries(dataset: Dataset, names: Sequence[str]) -> list[IndexEntry]:
    """Returns the rows of clips of a data set, with its name and its license if they say no other.

    The row of a twin follows from its original's, if that is here, too.
    """
    index = load_index(dataset.folder) or ClipIndex()
    known = set(names)
    originals = [name for name in names if not (name.startswith(MIRROR_PREFIX) and name[1:] in known)]
    return [index.entry(name).with_origin(dataset.info.name, dataset.info.licence) for name in originals]
