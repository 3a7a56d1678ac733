"""Writing a data-set folder so that it appears whole or not at all."""

import contextlib
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.config import save_config
from t2m_jax.data.files import FEATURES, INFO, MIRROR_PREFIX, POSITIONS, SPLITS, TEXTS
from t2m_jax.data.folder import DatasetInfo
from t2m_jax.data.texts import Caption, save_captions
from t2m_jax.errors import UserError
from t2m_jax.motion.features import features_from_positions, positions_from_features
from t2m_jax.motion.mirroring import mirror_caption, mirror_positions
from t2m_jax.motion.normalizer import normalizer_from_clips, save_normalizer
from t2m_jax.motion.skeleton import Skeleton


class ImportReport(NamedTuple):
    """What an import did, for the command line and for tests."""

    num_clips: int
    """clips written, mirrored twins included"""
    num_frames: int
    """their feature rows"""
    split_sizes: dict[str, int]
    """clips of each split, twins included"""
    left_out: dict[str, str]
    """clip name -> why it was not written"""
    notes: tuple[str, ...]
    """what else a user should know, one sentence each"""


@contextlib.contextmanager
def new_folder(destination: Path) -> Iterator[Path]:
    """Yields an empty folder which takes the name `destination` when the block ends well and vanishes otherwise.

    Raises:
        UserError: `destination` exists and holds something, or cannot be made.
    """
    destination = destination.absolute()
    if destination.exists() and (not destination.is_dir() or any(destination.iterdir())):
        raise UserError(f"{destination}: exists already; name a new folder or delete that one")
    partial = destination.with_name(f".{destination.name}.partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
    except OSError as error:
        raise UserError(f"{destination}: cannot be written ({error.strerror}); choose another folder") from error
    try:
        yield partial
        partial.replace(destination)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def make_layout(folder: Path) -> None:
    """Makes the sub-folders of a data set."""
    for name in (FEATURES, POSITIONS, TEXTS):
        (folder / name).mkdir()


def write_clip(
    folder: Path, name: str, features: Float[np.ndarray, "T D"], *, captions: Sequence[Caption], skeleton: Skeleton
) -> None:
    """Writes one clip: features, the positions they decode to, captions."""
    np.save(folder / FEATURES / f"{name}.npy", features.astype(np.float32, copy=False))
    np.save(folder / POSITIONS / f"{name}.npy", positions_from_features(features, skeleton))
    save_captions(folder / TEXTS / f"{name}.txt", captions)


def write_twins(
    folder: Path, name: str, positions: Float[np.ndarray, "T J 3"], *, captions: Sequence[Caption], skeleton: Skeleton
) -> int:
    """Writes a clip and its mirrored twin from joint positions and returns the number of feature rows of each.

    The twin is encoded from mirrored positions, not by flipping features: the template has unequal legs and the
    rotation features no mirror image.

    Raises:
        UserError: the features are not finite (a bone of no length, a single frame).
    """
    features = _finite(features_from_positions(positions, skeleton), name)
    twin = _finite(features_from_positions(mirror_positions(positions, skeleton), skeleton), name)
    mirrored = [mirror(caption) for caption in captions]
    write_clip(folder, name, features, captions=captions, skeleton=skeleton)
    write_clip(folder, MIRROR_PREFIX + name, twin, captions=mirrored, skeleton=skeleton)
    return len(features)


def _finite(features: Float[np.ndarray, "T D"], name: str) -> Float[np.ndarray, "T D"]:
    """Returns the features if all are finite."""
    if len(features) == 0 or not np.all(np.isfinite(features)):
        raise UserError(f"{name}: no finite features; the clip has less than two frames or a bone of no length")
    return features


def mirror(caption: Caption) -> Caption:
    """Returns the caption of the mirrored motion: left and right exchanged in text and tokens."""
    tokens = tuple(mirror_caption(token) for token in caption.tokens)
    return caption._replace(text=mirror_caption(caption.text), tokens=tokens)


def with_twins(names: Sequence[str]) -> list[str]:
    """Returns the names, each followed by its mirrored twin: both always share a split."""
    return [twin for name in names for twin in (name, MIRROR_PREFIX + name)]


def finish_folder(
    folder: Path, splits: Mapping[str, Sequence[str]], *, info: DatasetInfo, skeleton: Skeleton
) -> dict[str, int]:
    """Writes split lists, statistics and `dataset.yaml`, and returns the sizes of the splits.

    The statistics are those of the training clips. HumanML3D's published ones are over all files, test included; a
    model measured on the test split should not have seen even its mean.

    Raises:
        UserError: the training split is empty.
    """
    if not splits.get("train"):
        raise UserError(f"{info.name}: no clip is left for training; check the split lists and the captions")
    for split in SPLITS:
        lines = "".join(f"{name}\n" for name in splits.get(split, ()))
        (folder / f"{split}.txt").write_text(lines, encoding="utf-8")
    clips = (np.load(folder / FEATURES / f"{name}.npy") for name in splits["train"])
    save_normalizer(folder, normalizer_from_clips(clips, skeleton.layout))
    save_config(folder / INFO, info)
    return {split: len(splits.get(split, ())) for split in SPLITS}
