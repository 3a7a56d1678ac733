"""Reading a data-set folder: HumanML3D's layout, so that the real one just works.

new_joint_vecs/<id>.npy [T, D] float32, raw    new_joints/<id>.npy [T, J, 3] (optional)    texts/<id>.txt
train.txt val.txt test.txt    Mean.npy Std.npy    dataset.yaml (optional)
"""

import dataclasses
import logging
import string
from pathlib import Path
from tokenize import TokenError
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.config import UserError, load_config
from t2m_jax.data.texts import Caption, load_captions
from t2m_jax.motion.normalizer import Normalizer, load_normalizer
from t2m_jax.motion.skeleton import Skeleton, skeleton_from_feature_dim, skeleton_from_name

logger = logging.getLogger(__name__)

FEATURES, POSITIONS, TEXTS, INFO = "new_joint_vecs", "new_joints", "texts", "dataset.yaml"
SPLITS = ("train", "val", "test")
MIRROR_PREFIX = "M"


@dataclasses.dataclass(frozen=True, kw_only=True)
class DatasetInfo:
    """What `dataset.yaml` says of a data set."""

    name: str
    """What people call it."""
    skeleton: str = "humanml3d"
    """Name of the skeleton its features are made for."""
    fps: float = 20.0
    """Frames a second of its features."""
    min_frames: int = 1
    """Shorter clips are not trained on."""
    max_frames: int = 196
    """Longest motion that a model of this data should see; longer clips are kept whole and cut while training."""
    licence: str = ""
    """Terms of use of the motion."""
    source: str = ""
    """Where the motion comes from."""
    attribution: str = ""
    """What has to be said wherever something derived from the data is shown."""


class Clip(NamedTuple):
    """One motion (features, raw) and what is said about it."""

    name: str
    features: Float[np.ndarray, "T D"]
    captions: tuple[Caption, ...]

    @property
    def is_mirrored(self) -> bool:
        """Whether the clip is the mirrored twin of another."""
        return self.name.startswith(MIRROR_PREFIX)


def load_features(path: Path, *, feature_dim: int) -> Float[np.ndarray, "T D"]:
    """Returns the raw features of one clip; they may hold NaN.

    Raises:
        UserError: the file is missing, is no .npy array of numbers, or has another width.
    """
    array = load_array(path)
    if array.ndim != 2 or array.shape[1] != feature_dim:
        shape = "x".join(str(size) for size in array.shape)
        raise UserError(f"{path}: has shape {shape}, expected T x {feature_dim}; is it features of another skeleton?")
    return array.astype(np.float32, copy=False)


def load_array(path: Path, *, mmap: bool = False) -> np.ndarray:  # any shape: the caller checks it
    """Returns the array in a .npy file of floating-point numbers.

    Raises:
        UserError: the file is missing or damaged, or holds something else.
    """
    try:
        array = np.load(path, mmap_mode="r" if mmap else None, allow_pickle=False)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error}); is the copy complete?") from error
    except (ValueError, EOFError, TokenError) as error:  # the last from a damaged header
        raise UserError(f"{path}: is not a complete .npy file ({error}); copy or import it again") from error
    if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
        raise UserError(f"{path}: holds no floating-point numbers; expected a float32 array")
    return array


def read_names(path: Path) -> tuple[str, ...]:
    """Returns the clip names of a split list, one a line, blank lines skipped.

    Raises:
        UserError: the list is missing, or a name in it would leave the folder.
    """
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except OSError as error:
        raise UserError(
            f"{path}: cannot be read ({error.strerror}); it lists the clips of the split, one a line"
        ) from error
    for number, line in enumerate(lines, start=1):
        if "/" in line or "\\" in line:
            raise UserError(f"{path}:{number}: '{line}' is no clip name; names have no folder part")
    return tuple(line.strip() for line in lines if line.strip())


def _guess_info(folder: Path) -> DatasetInfo:
    """Returns what the width of the features tells of a folder without `dataset.yaml`."""
    files = [folder / "Mean.npy"] if (folder / "Mean.npy").exists() else sorted((folder / FEATURES).glob("*.npy"))[:1]
    if not files:
        raise UserError(f"{folder}: no data set here; expected {FEATURES}/*.npy, texts/*.txt and train.txt")
    skeleton = skeleton_from_feature_dim(load_array(files[0], mmap=True).shape[-1])
    return DatasetInfo(
        name=folder.resolve().name,
        skeleton=skeleton.name,
        fps=skeleton.fps,
        min_frames=skeleton.min_frames,
        max_frames=skeleton.max_frames,
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Dataset:
    """An opened data-set folder; clips are read when asked for."""

    folder: Path
    """Where it is."""
    info: DatasetInfo
    """What `dataset.yaml` says, or what the features' width tells."""
    skeleton: Skeleton
    """Skeleton of its features."""

    @property
    def normalizer(self) -> Normalizer:
        """Returns the statistics that travel with the data (`Mean.npy`, `Std.npy`)."""
        return load_normalizer(self.folder)

    def names(self, split: str) -> tuple[str, ...]:
        """Returns the clips of a split in the order of its list."""
        return read_names(self.folder / f"{split}.txt")

    def features(self, name: str) -> Float[np.ndarray, "T D"]:
        """Returns the raw features of a clip."""
        return load_features(self.folder / FEATURES / f"{name}.npy", feature_dim=self.skeleton.feature_dim)

    def captions(self, name: str) -> tuple[Caption, ...]:
        """Returns the captions of a clip."""
        return load_captions(self.folder / TEXTS / f"{name}.txt")

    def clips(
        self, split: str, *, min_frames: int = 1, mirrored: bool = True, skip_missing: bool = False
    ) -> list[Clip]:
        """Returns the clips of a split, whole, in the order of its list.

        Clips that hold NaN are left out, and so are those shorter than `min_frames`; a warning counts them.

        Args:
            split: "train", "val", "test" or any other list in the folder.
            min_frames: least number of feature rows.
            mirrored: include mirrored twins.
            skip_missing: leave out clips whose files are missing (the published KIT-ML lists name some) in place of
                refusing.

        Raises:
            UserError: a file is missing, damaged or of another feature width; the message names it.
        """
        clips: list[Clip] = []
        broken, short = [], 0
        for name in self.names(split):
            if (name.startswith(MIRROR_PREFIX) and not mirrored) or (skip_missing and not self.has(name)):
                continue
            features = self.features(name)
            if not np.all(np.isfinite(features)):
                broken.append(name)
            elif len(features) < min_frames:
                short += 1
            else:
                clips.append(Clip(name, features, self.captions(name)))
        if broken:
            logger.warning(
                "%s: %d clips of %s hold NaN and are left out: %s",
                self.folder,
                len(broken),
                split,
                ", ".join(broken[:5]),
            )
        if short:
            logger.warning(
                "%s: %d clips of %s are shorter than %d frames and are left out", self.folder, short, split, min_frames
            )
        return clips

    def has(self, name: str) -> bool:
        """Returns whether both files of a clip are there."""
        return (self.folder / FEATURES / f"{name}.npy").exists() and (self.folder / TEXTS / f"{name}.txt").exists()


def open_dataset(folder: str | Path) -> Dataset:
    """Returns the data set in a folder; without `dataset.yaml` the width of the features decides what it is.

    Raises:
        UserError: the folder is none, or its `dataset.yaml` is wrong.
    """
    folder = Path(folder)
    if not (folder / FEATURES).is_dir():
        raise UserError(f"{folder}: no data set here; expected {FEATURES}/*.npy, texts/*.txt and train.txt")
    info = load_config(folder / INFO, DatasetInfo) if (folder / INFO).exists() else _guess_info(folder)
    return Dataset(folder=folder, info=info, skeleton=skeleton_from_name(info.skeleton))


def samples_from_clip(clip: Clip, info: DatasetInfo) -> list[Clip]:
    """Returns the samples that a clip counts as in text-to-motion: whole, and once for each time-tagged caption.

    Captions with times become samples of their own, named "A_<clip>", "B_<clip>" ... (HumanML3D draws the letter at
    random). Whole or part, a sample outside `min_frames`...`max_frames` + 3 (a length that a multiple of four rounds
    down to the maximum) is dropped, and with a whole clip all its parts, as the published loaders do.
    """

    def fits(length: int) -> bool:
        return info.min_frames <= length < info.max_frames + 4

    if not fits(len(clip.features)):
        return []
    whole = tuple(caption for caption in clip.captions if caption.whole_clip)
    samples = [Clip(clip.name, clip.features, whole)] if whole else []
    parts = [caption for caption in clip.captions if not caption.whole_clip]
    for letter, caption in zip(string.ascii_uppercase, parts, strict=False):
        features = clip.features[int(caption.start * info.fps) : int(caption.end * info.fps)]
        if fits(len(features)):
            samples.append(Clip(f"{letter}_{clip.name}", features, (caption._replace(start=0.0, end=0.0),)))
    return samples
