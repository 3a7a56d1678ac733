"""Importing a folder that has HumanML3D's layout already: copied, checked, and given a `dataset.yaml`."""

import shutil
from pathlib import Path

import tqdm

from t2m_jax.data.files import FEATURES, POSITIONS, SPLITS, TEXTS, ClipFiles, clip_or_reason
from t2m_jax.data.folder import Dataset, open_dataset
from t2m_jax.data.index import INDEX
from t2m_jax.data.texts import save_captions
from t2m_jax.data.writer import ImportReport, finish_folder, make_layout, new_folder


def _copy_clip(dataset: Dataset, name: str, folder: Path) -> ClipFiles | str:
    """Returns the clip after copying its files, or why it was not copied."""
    clip = clip_or_reason(dataset.folder, name, feature_dim=dataset.skeleton.feature_dim)
    if isinstance(clip, str):
        return clip
    for part, suffix in ((FEATURES, ".npy"), (POSITIONS, ".npy"), (TEXTS, ".txt")):
        file = dataset.folder / part / f"{name}{suffix}"
        if file.exists():
            shutil.copyfile(file, folder / part / file.name)
    if clip.captions.problems:
        save_captions(folder / TEXTS / f"{name}.txt", clip.captions.captions)
    return clip


def _copy_statistics(dataset: Dataset, folder: Path) -> str:
    """Returns where the statistics of the copy come from: the source's are taken over if there."""
    if not all((dataset.folder / file).exists() for file in ("Mean.npy", "Std.npy")):
        return "statistics computed from the training clips"
    for file in ("Mean.npy", "Std.npy"):
        shutil.copyfile(dataset.folder / file, folder / file)
    return "statistics taken over as they are"


def import_humanml3d(source: str | Path, destination: str | Path) -> ImportReport:
    """Returns what was copied from a folder of HumanML3D's layout (or KIT-ML's) into a new data-set folder.

    The statistics are taken over if there, else computed from the training clips. Clips that nothing can use are left
    out: the published lists name some whose files are missing, and one clip of HumanML3D is NaN. So are caption lines
    that cannot be read.

    Raises:
        UserError: no data set there, a list missing, no clip left to train on, or a destination that exists.
    """
    dataset = open_dataset(source)
    splits = {split: dataset.names(split) for split in SPLITS}
    frames: dict[str, int] = {}
    broken: list[str] = []
    left_out: dict[str, str] = {}
    with new_folder(Path(destination)) as folder:
        make_layout(folder)
        for name in tqdm.tqdm([name for names in splits.values() for name in names], unit="clip", desc="copying"):
            copied = _copy_clip(dataset, name, folder)
            if isinstance(copied, str):
                left_out[name] = copied
                continue
            frames[name] = len(copied.features)
            broken += copied.captions.problems
        kept = {split: [name for name in names if name in frames] for split, names in splits.items()}
        sizes = finish_folder(folder, kept, info=dataset.info, skeleton=dataset.skeleton)
        notes = [_copy_statistics(dataset, folder)]
        if (dataset.folder / INDEX).exists():
            shutil.copyfile(dataset.folder / INDEX, folder / INDEX)
        if broken:
            notes.append(f"{len(broken)} caption lines that cannot be read are left out, such as {broken[0]}")
    return ImportReport(sum(sizes.values()), sum(frames.values()), sizes, left_out, tuple(notes))
