"""Importing a folder that already has HumanML3D's layout: it is checked, copied, and gets a `dataset.yaml`."""

import shutil
from pathlib import Path

import tqdm

from t2m_jax.data.checks import check_overlap
from t2m_jax.data.files import SPLITS, TEXTS, clip_or_reason
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.index import INDEX
from t2m_jax.data.merge import copy_clip
from t2m_jax.data.texts import save_captions
from t2m_jax.data.writer import ImportReport, finish_folder, new_folder

STATISTICS = ("Mean.npy", "Std.npy")


def import_humanml3d(source: str | Path, destination: str | Path) -> ImportReport:
    """Copies a folder with the layout of HumanML3D (or KIT-ML) into a new folder and returns a report.

    The statistics are copied if the folder has them, else computed from the training clips. Clips that cannot be used
    are left out: the published lists name some clips without files, and one clip of HumanML3D is NaN. So are caption
    lines that cannot be read.

    Raises:
        UserError: There is no data set, a list is missing, no clip is left for training, or the destination exists.
    """
    dataset = open_dataset(source)
    splits = {split: dataset.names(split) for split in SPLITS}
    frames: dict[str, int] = {}
    broken: list[str] = []
    left_out: dict[str, str] = {}
    with new_folder(destination) as folder:
        for name in tqdm.tqdm([name for names in splits.values() for name in names], unit="clip", desc="copying"):
            clip = clip_or_reason(dataset.folder, name, feature_dim=dataset.skeleton.feature_dim)
            if isinstance(clip, str):
                left_out[name] = clip
                continue
            copy_clip(name, dataset, folder)
            # Once more, without the broken lines.
            if clip.captions.problems:
                save_captions(folder / TEXTS / f"{name}.txt", clip.captions.captions)
            frames[name] = len(clip.features)
            broken += clip.captions.problems
        kept = {split: [name for name in names if name in frames] for split, names in splits.items()}
        sizes = finish_folder(folder, kept, info=dataset.info, skeleton=dataset.skeleton)
        has_statistics = all((dataset.folder / file).exists() for file in STATISTICS)
        # They replace the computed ones: published weights expect the published statistics.
        for file in (*(STATISTICS if has_statistics else ()), INDEX):
            if (dataset.folder / file).exists():
                shutil.copyfile(dataset.folder / file, folder / file)
    notes = ["statistics copied" if has_statistics else "statistics computed from the training clips"]
    if overlap := check_overlap(splits):  # which of the lists is right, only their author knows
        notes.append(f"{len(overlap)} clips are in two lists, or twice in one, such as {overlap[0]}")
    if broken:
        notes.append(f"{len(broken)} caption lines that cannot be read are left out, such as {broken[0]}")
    return ImportReport(sum(sizes.values()), sum(frames.values()), sizes, left_out, tuple(notes))
