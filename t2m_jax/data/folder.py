"""A data-set folder: its splits as whole clips, and the samples that text-to-motion models use."""

import dataclasses
import logging
import string
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.config import load_config
from t2m_jax.data.cache import open_clips
from t2m_jax.data.files import FEATURES, INFO, MIRROR_PREFIX, SPLITS, TEXTS, read_names
from t2m_jax.data.splits import nested_choice
from t2m_jax.data.texts import Caption, load_captions
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import fingerprint
from t2m_jax.files.reading import load_array
from t2m_jax.motion.normalizer import Normalizer, load_normalizer
from t2m_jax.motion.resampling import MAX_FPS
from t2m_jax.motion.skeleton import Skeleton, skeleton_from_feature_dim, skeleton_from_name

logger = logging.getLogger(__name__)

MAX_NAMED = 5
"""Number of clips or lines that a message names."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class DatasetInfo:
    """The contents of `dataset.yaml`."""

    name: str
    """Name of the data set."""
    skeleton: str = "humanml3d"
    """Name of the skeleton of its features."""
    fps: float = 20.0
    """Frames per second of its features."""
    min_frames: int = 1
    """Shorter clips are not used for training."""
    max_frames: int = 196
    """Longest motion that a model of this data should see. Longer clips are stored whole: tokenizers learn windows of
    them, and generators leave them out, with captions of their parts, unless `long_clips` is `windows`."""
    licence: str = ""
    """License of the motion."""
    source: str = ""
    """Origin of the motion."""
    attribution: str = ""
    """Text that must be shown wherever something derived from the data is shown."""

    def __post_init__(self) -> None:
        skeleton_from_name(self.skeleton)
        if not 0 < self.fps <= MAX_FPS:
            raise ValueError(f"fps: {self.fps} is not a number of frames per second above 0 and up to {MAX_FPS:g}")
        if not 1 <= self.min_frames <= self.max_frames:
            raise ValueError(f"min_frames, max_frames: {self.min_frames} and {self.max_frames} are not 1 <= min <= max")

    def fits(self, num_frames: int) -> bool:
        """Returns whether text-to-motion models use a motion of this length.

        Motions may be up to three frames longer than the maximum, as in HumanML3D, where they are cut to whole codes
        of four frames.
        """
        return self.min_frames <= num_frames < self.max_frames + 4


class Clip(NamedTuple):
    """One motion (raw features) and its captions."""

    name: str
    features: Float[np.ndarray, "T D"]
    captions: tuple[Caption, ...]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Dataset:
    """An opened data-set folder.

    `clips` reads from a cache of the whole folder, which is made when it is first needed and when files have changed.
    `features` and `captions` read the files of one clip.
    """

    folder: Path
    """Path of the folder."""
    info: DatasetInfo
    """Contents of `dataset.yaml`, or defaults that follow from the feature width."""
    skeleton: Skeleton
    """Skeleton of its features."""

    @property
    def normalizer(self) -> Normalizer:
        """The statistics in the folder (`Mean.npy`, `Std.npy`)."""
        normalizer = load_normalizer(self.folder)
        found = len(normalizer.mean)
        expected = self.skeleton.feature_dim
        if found != expected:
            raise UserError(
                f"{self.folder / 'Mean.npy'}: has {found} columns, but skeleton {self.skeleton.name} has {expected} "
                "features; import the data again"
            )
        return normalizer

    @property
    def fingerprint(self) -> str:
        """Identifies the contents: clips, captions, splits and statistics, wherever the folder is."""
        clips, lists, limits, statistics = self._contents()
        return fingerprint(f"{clips} {lists} {limits}", statistics)

    @property
    def fingerprints(self) -> dict[str, str]:
        """Identifies each part of the contents."""
        clips, lists, limits, statistics = self._contents()
        texts = {"splits": f"{lists}", "skeleton and lengths": f"{limits}"}
        found = {"clips and captions": clips} | {name: fingerprint(text, {}) for name, text in texts.items()}
        return found | {"statistics": fingerprint("", statistics)}

    def _contents(self) -> tuple[str, dict[str, tuple[str, ...]], tuple[Any, ...], dict[str, Any]]:
        """Returns the fingerprint of clips and captions, the splits, the limits and the statistics."""
        lists = {split: self.names(split) for split in SPLITS if (self.folder / f"{split}.txt").exists()}
        cached = open_clips(self.folder, feature_dim=self.skeleton.feature_dim)
        limits = (self.skeleton.name, self.info.fps, self.info.min_frames, self.info.max_frames)
        statistics = self.normalizer._asdict() if (self.folder / "Mean.npy").exists() else {}
        return cached.fingerprint, lists, limits, statistics

    def names(self, split: str) -> tuple[str, ...]:
        """Returns the clip names of a split in the order of its list."""
        return read_names(self.folder / f"{split}.txt")

    def features(self, name: str) -> Float[np.ndarray, "T D"]:
        """Returns the raw features of a clip. They may contain NaN.

        Raises:
            UserError: The file is missing or damaged, or has another width.
        """
        path = self.folder / FEATURES / f"{name}.npy"
        array = load_array(path)
        if array.ndim != 2 or array.shape[1] != self.skeleton.feature_dim:
            shape = "x".join(str(size) for size in array.shape)
            wanted = f"T x {self.skeleton.feature_dim}"
            raise UserError(f"{path}: has shape {shape}, expected {wanted}; is it for another skeleton?")
        return array.astype(np.float32, copy=False)

    def captions(self, name: str) -> tuple[Caption, ...]:
        """Returns the captions of a clip. A line that cannot be read is an error."""
        return load_captions(self.folder / TEXTS / f"{name}.txt")

    def clips(
        self, split: str, *, min_frames: int = 1, mirrored: bool = True, fraction: float = 1.0, seed: int = 0
    ) -> list[Clip]:
        """Returns the whole clips of a split in the order of its list. Their features are read-only views of a file.

        Clips that cannot be used are left out: files are missing or damaged, values are not finite, there is only one
        frame, or the width is wrong. So are caption lines that cannot be read, and clips shorter than `min_frames`.
        Warnings count and name them.

        Args:
            split: "train", "val", "test" or any other list in the folder.
            min_frames: Smallest number of feature rows.
            mirrored: Include mirrored twins.
            fraction: Share of the list that is used, above 0 and up to 1. A smaller share is part of a larger one,
                and a clip and its mirrored twin stay together.
            seed: Another seed gives another share.

        Raises:
            UserError: The list is missing, or more than half of its clips cannot be used.
        """
        names = [name for name in self.names(split) if mirrored or not name.startswith(MIRROR_PREFIX)]
        names = nested_choice(names, fraction=fraction, seed=seed)
        cached = open_clips(self.folder, feature_dim=self.skeleton.feature_dim, names=names)
        usable = [name for name in names if name in cached.spans]
        if len(usable) < len(names):
            unusable = (name for name in names if name not in cached.spans)
            reasons = {name: cached.left_out.get(name, "without motion and caption file") for name in unusable}
            words = f"{len(reasons)} of {len(names)} clips cannot be used: {left_out_in_words(reasons)}"
            # Published lists name some clips that cannot be used; so many mean a copy that is not complete.
            if 2 * len(reasons) > len(names):
                raise UserError(
                    f"{self.folder / split}.txt: {words}; is the copy complete? Run `t2m data check` for details"
                )
            logger.warning("%s: %s; left out of %s", self.folder, words, split)
        broken = [name for name in names if name in cached.broken_captions]
        if broken:
            count = sum(cached.broken_captions[name] for name in broken)
            words = f"{count} caption lines of {split} cannot be read and are left out, in clips {first_names(broken)}"
            logger.warning("%s: %s; run `t2m data check` for details", self.folder, words)
        clips = [name for name in usable if len(cached.features(name)) >= min_frames]
        if len(clips) < len(usable):
            words = f"{len(usable) - len(clips)} clips of {split} are shorter than {min_frames} frames"
            logger.warning("%s: %s and are left out", self.folder, words)
        return [Clip(name, cached.features(name), cached.captions(name)) for name in clips]


def left_out_in_words(left_out: Mapping[str, str]) -> str:
    """Returns the number of clips that were left out for each reason, with the first names."""
    kinds: dict[str, list[str]] = {}
    for name, reason in left_out.items():
        kinds.setdefault(reason, []).append(name)
    return "; ".join(f"{len(names)} {reason} ({first_names(names)})" for reason, names in kinds.items())


def first_names(names: Sequence[str]) -> str:
    """Returns the first names of a list, and dots if there are more."""
    return ", ".join(names[:MAX_NAMED]) + (", ..." if len(names) > MAX_NAMED else "")


def open_dataset(folder: str | Path) -> Dataset:
    """Returns the data set in a folder. Without `dataset.yaml`, the feature width decides which skeleton it has.

    Raises:
        UserError: The folder is not a data set, or its `dataset.yaml` is wrong.
    """
    folder = Path(folder)
    nothing = UserError(f"{folder}: no data set here; expected {FEATURES}/*.npy, texts/*.txt and train.txt")
    if not (folder / FEATURES).is_dir():
        raise nothing
    if (folder / INFO).exists():
        info = load_config(folder / INFO, DatasetInfo)
        return Dataset(folder=folder, info=info, skeleton=skeleton_from_name(info.skeleton))
    mean = folder / "Mean.npy"
    example = mean if mean.exists() else min((folder / FEATURES).glob("*.npy"), default=None)
    if example is None:
        raise nothing
    skeleton = skeleton_from_feature_dim((0, *load_array(example, mmap=True).shape)[-1])  # 0 for an array without axes
    info = DatasetInfo(
        name=folder.resolve().name,
        skeleton=skeleton.name,
        fps=skeleton.fps,
        min_frames=skeleton.min_frames,
        max_frames=skeleton.max_frames,
    )
    return Dataset(folder=folder, info=info, skeleton=skeleton)


def samples_from_clip(clip: Clip, info: DatasetInfo) -> list[Clip]:
    """Returns the samples that a clip counts as in text-to-motion: whole, and one for each caption with times.

    Samples of captions with times are named "A_<clip>", "B_<clip>" ..., after Z "AA_<clip>" (HumanML3D draws the letter
    at random). Samples that are too short or too long (`DatasetInfo.fits`) are dropped. If the whole clip is too short
    or too long, all its samples are dropped, as in the published loaders.
    """
    # Here and not below: the published loaders look at the whole clip before its parts.
    if not info.fits(len(clip.features)):
        return []
    whole = tuple(caption for caption in clip.captions if caption.whole_clip)
    samples = [Clip(clip.name, clip.features, whole)] if whole else []
    parts = [caption for caption in clip.captions if not caption.whole_clip]
    for number, caption in enumerate(parts):
        features = clip.features[int(caption.start * info.fps) : int(caption.end * info.fps)]
        if info.fits(len(features)):
            name = f"{_letters(number)}_{clip.name}"
            # The frames are cut to the times of the caption, which now describes all of them.
            samples.append(Clip(name, features, (caption._replace(start=0.0, end=0.0),)))
    return samples


def _letters(number: int) -> str:
    """Returns A ... Z, AA, AB ... for 0, 1 ..."""
    before, last = divmod(number, len(string.ascii_uppercase))
    return (_letters(before - 1) if before else "") + string.ascii_uppercase[last]
