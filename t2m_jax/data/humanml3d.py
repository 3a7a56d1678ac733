"""Importing a folder that has HumanML3D's layout already: copied, checked, and given a `dataset.yaml`."""

import shutil
from pathlib import Path

import tqdm

from t2m_jax.config import UserError
from t2m_jax.data.folder import FEATURES, POSITIONS, SPLITS, TEXTS, Dataset, open_dataset
from t2m_jax.data.writer import ImportReport, finish_folder, make_layout, new_folder


def _copy_clip(dataset: Dataset, name: str, folder: Path) -> int:
    """Returns the number of feature rows of a clip after copying its files."""
    frames = len(dataset.features(name))
    dataset.captions(name)
    for part, suffix in ((FEATURES, ".npy"), (POSITIONS, ".npy"), (TEXTS, ".txt")):
        file = dataset.folder / part / f"{name}{suffix}"
        if part != POSITIONS or file.exists():
            shutil.copyfile(file, folder / part / file.name)
    return frames


def import_humanml3d(source: str | Path, destination: str | Path) -> ImportReport:
    """Returns what was copied from a folder of HumanML3D's layout (or KIT-ML's) into a new data-set folder.

    The statistics are taken over if there, else computed from the training clips. Clips that a list names but whose
    files are missing are left out, since the published lists have such.

    Raises:
        UserError: no data set there, a damaged file, a list missing, or a destination that exists.
    """
    dataset = open_dataset(source)
    splits = {split: dataset.names(split) for split in SPLITS}
    left_out = {name: "its files are missing" for names in splits.values() for name in names if not dataset.has(name)}
    kept = {split: [name for name in names if name not in left_out] for split, names in splits.items()}
    if not kept["train"]:
        raise UserError(f"{dataset.folder / 'train.txt'}: names no clip whose files are there")
    frames = 0
    with new_folder(Path(destination)) as folder:
        make_layout(folder)
        for name in tqdm.tqdm([name for names in kept.values() for name in names], unit="clip", desc="copying"):
            frames += _copy_clip(dataset, name, folder)
        sizes = finish_folder(folder, kept, info=dataset.info, skeleton=dataset.skeleton)
        notes: tuple[str, ...] = ("statistics computed from the training clips",)
        if (dataset.folder / "Mean.npy").exists() and (dataset.folder / "Std.npy").exists():
            for file in ("Mean.npy", "Std.npy"):
                shutil.copyfile(dataset.folder / file, folder / file)
            notes = ("statistics taken over as they are",)
    return ImportReport(sum(sizes.values()), frames, sizes, left_out, notes)
