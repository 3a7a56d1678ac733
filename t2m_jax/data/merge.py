"""Putting several data sets into one folder."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from t2m_jax.data.files import FEATURES, MIRROR_PREFIX, POSITIONS, SPLITS, TEXTS
from t2m_jax.data.folder import Dataset, DatasetInfo, open_dataset
from t2m_jax.data.index import IndexEntry, load_index, save_index
from t2m_jax.data.writer import ImportReport, finish_folder, new_folder
from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_array, reading


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
        for split in SPLITS:
            names = dataset.names(split) if (dataset.folder / f"{split}.txt").exists() else ()
            for name in names:
                if owners.setdefault(name, dataset) is not dataset:
                    raise UserError(f"{dataset.folder}: {name} is a clip of {owners[name].folder}, too; rename one")
            splits[split] += names
    with new_folder(destination) as folder:
        frames = sum(_copy_clip(name, dataset, folder) for name, dataset in owners.items())
        sizes = finish_folder(folder, splits, info=_merged_info(datasets), skeleton=first.skeleton)
        save_index(folder, _labels(owners))
    return ImportReport(len(owners), frames, sizes, {}, ())


def _copy_clip(name: str, dataset: Dataset, folder: Path) -> int:
    """Copies the files of a clip and returns its number of frames."""
    for part in (f"{FEATURES}/{name}.npy", f"{POSITIONS}/{name}.npy", f"{TEXTS}/{name}.txt"):
        with reading(dataset.folder / part):
            contents = (dataset.folder / part).read_bytes()
        (folder / part).write_bytes(contents)
    return len(load_array(folder / FEATURES / f"{name}.npy", mmap=True))


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


def _labels(owners: dict[str, Dataset]) -> list[IndexEntry]:
    """Returns the rows of all clips of which something is known, with the data set and the license of each."""
    indices = {dataset.folder: load_index(dataset.folder) for dataset in owners.values()}
    rows = []
    for name, dataset in owners.items():
        index = indices[dataset.folder]
        # The label of a twin follows from its original's row, if that is here, too.
        if index is not None and not (name.startswith(MIRROR_PREFIX) and name[1:] in owners):
            rows.append(index.entry(name).with_origin(dataset.info.name, dataset.info.licence))
    return rows
