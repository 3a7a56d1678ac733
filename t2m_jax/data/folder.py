"""An opened data-set folder: its splits as clips, whole, and as the samples that text-to-motion counts."""

import dataclasses
import logging
import string
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.config import load_config
from t2m_jax.data.cache import open_clips
from t2m_jax.data.files import FEATURES, INFO, MIRROR_PREFIX, TEXTS, load_array, load_features, read_names
from t2m_jax.data.splits import nested_choice
from t2m_jax.data.texts import Caption, load_captions
from t2m_jax.errors import UserError
from t2m_jax.motion.normalizer import Normalizer, load_normalizer
from t2m_jax.motion.skeleton import Skeleton, skeleton_from_feature_dim, skeleton_from_name

logger = logging.getLogger(__name__)

NAMED = 5
"""How many clips of one kind a message names."""


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

    def fits(self, num_frames: int) -> bool:
        """Returns whether text-to-motion uses a motion of this length; a little over the maximum is rounded down."""
        return self.min_frames <= num_frames < self.max_frames + 4


class Clip(NamedTuple):
    """One motion (features, raw) and what is said about it."""

    name: str
    features: Float[np.ndarray, "T D"]
    captions: tuple[Caption, ...]

    @property
    def is_mirrored(self) -> bool:
        """Whether the clip is the mirrored twin of another."""
        return self.name.startswith(MIRROR_PREFIX)


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
    """An opened data-set folder.

    `clips` reads from a cache of the whole folder, which is made on first use and whenever the files have changed;
    `features` and `captions` look at the files of one clip.
    """

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
        """Returns the captions of a clip, all of which must be sound."""
        return load_captions(self.folder / TEXTS / f"{name}.txt")

    def clips(
        self, split: str, *, min_frames: int = 1, mirrored: bool = True, fraction: float = 1.0, seed: int = 0
    ) -> list[Clip]:
        """Returns the clips of a split, whole, in the order of its list; their features are read-only views of a file.

        Clips that cannot be used are left out: files missing or damaged, NaN, a single frame, another width. So are
        caption lines that cannot be read, and clips shorter than `min_frames`. Warnings count and name them.

        Args:
            split: "train", "val", "test" or any other list in the folder.
            min_frames: least number of feature rows.
            mirrored: include mirrored twins.
            fraction: share of the list that is used, above 0 and up to 1; a smaller share is part of a larger one, and
                a clip and its mirrored twin go together.
            seed: another one gives another share.

        Raises:
            UserError: the list is missing, or more than half of its clips cannot be used.
        """
        names = [name for name in self.names(split) if mirrored or not name.startswith(MIRROR_PREFIX)]
        names = nested_choice(names, fraction=fraction, seed=seed)
        cached = open_clips(self.folder, feature_dim=self.skeleton.feature_dim)
        left_out = {
            name: cached.left_out.get(name, "without motion and caption file")
            for name in names
            if name not in cached.spans
        }
        self._tell_left_out(split, left_out, num_clips=len(names))
        broken = [name for name in names if name in cached.broken_captions]
        if broken:
            logger.warning(
                "%s: %d caption lines of %s cannot be read and are left out, in clips %s; `t2m data check` tells more",
                self.folder,
                sum(cached.broken_captions[name] for name in broken),
                split,
                _first_of(broken),
            )
        usable = [name for name in names if name in cached.spans]
        clips = [name for name in usable if len(cached.features(name)) >= min_frames]
        if len(clips) < len(usable):
            logger.warning(
                "%s: %d clips of %s are shorter than %d frames and are left out",
                self.folder,
                len(usable) - len(clips),
                split,
                min_frames,
            )
        return [Clip(name, cached.features(name), cached.captions(name)) for name in clips]

    def _tell_left_out(self, split: str, left_out: Mapping[str, str], *, num_clips: int) -> None:
        """Warns of clips that cannot be used, and refuses a split that mostly cannot."""
        if not left_out:
            return
        words = f"{len(left_out)} of {num_clips} clips cannot be used: {left_out_in_words(left_out)}"
        if 2 * len(left_out) > num_clips:
            raise UserError(
                f"{self.folder / split}.txt: {words}; is the copy complete? `t2m data check` tells more of each"
            )
        logger.warning("%s: %s; left out of %s", self.folder, words, split)


def left_out_in_words(left_out: Mapping[str, str]) -> str:
    """Returns how many clips were left out for each reason, with the first names."""
    kinds: dict[str, list[str]] = {}
    for name, reason in left_out.items():
        kinds.setdefault(reason, []).append(name)
    return "; ".join(f"{len(names)} {reason} ({_first_of(names)})" for reason, names in kinds.items())


def _first_of(names: list[str]) -> str:
    """Returns the first names of a list, and a sign where there are more."""
    return ", ".join(names[:NAMED]) + (", ..." if len(names) > NAMED else "")


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

    Captions with times become samples of their own, named "A_<clip>", "B_<clip>" ..., after Z "AA_<clip>" (HumanML3D
    draws the letter at random). Whole or part, a sample outside `min_frames`...`max_frames` + 3 (a length that a
    multiple of four rounds down to the maximum) is dropped, and with a whole clip all its parts, as the published
    loaders do.
    """
    if not info.fits(len(clip.features)):
        return []
    whole = tuple(caption for caption in clip.captions if caption.whole_clip)
    samples = [Clip(clip.name, clip.features, whole)] if whole else []
    parts = [caption for caption in clip.captions if not caption.whole_clip]
    for number, caption in enumerate(parts):
        features = clip.features[int(caption.start * info.fps) : int(caption.end * info.fps)]
        if info.fits(len(features)):
            name = f"{_letters(number)}_{clip.name}"
            samples.append(Clip(name, features, (caption._replace(start=0.0, end=0.0),)))
    return samples


def _letters(number: int) -> str:
    """Returns A ... Z, AA, AB ... for 0, 1 ..."""
    before, last = divmod(number, len(string.ascii_uppercase))
    return (_letters(before - 1) if before else "") + string.ascii_uppercase[last]
