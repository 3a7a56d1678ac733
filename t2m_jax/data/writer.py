"""Writing a data-set folder, so that it appears complete or not at all."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.config import save_config
from t2m_jax.data.captioning.lexicon import tag_words
from t2m_jax.data.files import FEATURES, INFO, MIRROR_PREFIX, POSITIONS, SPLITS, TEXTS
from t2m_jax.data.folder import DatasetInfo
from t2m_jax.data.texts import Caption, save_captions
from t2m_jax.errors import UserError
from t2m_jax.files.manifest import write_manifest
from t2m_jax.files.writing import atomic_folder, save_text
from t2m_jax.motion.features import features_from_positions, positions_from_features
from t2m_jax.motion.mirroring import mirror_caption, mirror_positions
from t2m_jax.motion.normalizer import normalizer_from_clips, save_normalizer
from t2m_jax.motion.skeleton import Skeleton

MAX_NEW_CLIPS = 100_000
"""Most clips that are made at once, seven times those of HumanML3D; a larger number is probably a mistake."""


class ImportReport(NamedTuple):
    """The result of an import."""

    num_clips: int
    """Clips written, including mirrored twins."""
    num_frames: int
    """Feature rows of these clips."""
    split_sizes: dict[str, int]
    """Clips per split, including twins."""
    left_out: dict[str, str]
    """Clip name -> why it was not written."""
    notes: tuple[str, ...]
    """Further information for the user, one sentence each."""


def check_count(name: str, count: int, *, least: int) -> None:
    """Raises `UserError` if a number of clips to make is below `least`, or above `MAX_NEW_CLIPS`."""
    if not least <= count <= MAX_NEW_CLIPS:
        raise UserError(f"{name}: {count} is not a whole number from {least} to {MAX_NEW_CLIPS:,}")


@contextlib.contextmanager
def new_folder(destination: str | Path, *, parts: Sequence[str] = (FEATURES, POSITIONS, TEXTS)) -> Iterator[Path]:
    """Yields a folder with the sub-folders of a data set, which is renamed to `destination` when the block ends.

    Then it also has a manifest of its files. If the block fails, the folder is deleted.

    Raises:
        UserError: `destination` exists already and is not an empty folder, or it cannot be written.
    """
    with atomic_folder(Path(destination).absolute()) as folder:
        for part in parts:
            (folder / part).mkdir()
        yield folder
        write_manifest(folder)


def write_clip(
    folder: str | Path,
    name: str,
    features: Float[np.ndarray, "T D"],
    *,
    captions: Sequence[Caption],
    skeleton: Skeleton,
) -> None:
    """Writes the files of one clip: features, the joint positions that follow from them, and captions."""
    folder = Path(folder)
    np.save(folder / FEATURES / f"{name}.npy", features.astype(np.float32, copy=False))
    np.save(folder / POSITIONS / f"{name}.npy", positions_from_features(features, skeleton))
    save_captions(folder / TEXTS / f"{name}.txt", captions)


def write_twins(
    folder: Path,
    name: str,
    positions: Float[np.ndarray, "T J 3"],
    *,
    captions: Sequence[Caption],
    skeleton: Skeleton,
    twins: bool = True,
) -> int:
    """Writes a clip and, with `twins`, its mirrored twin; returns the number of feature rows of each.

    The twin is encoded from mirrored positions, not by flipping features: the legs of the template are not equally
    long, and the rotation features have no mirror image.

    Raises:
        UserError: The features are not finite (a bone has no length) or there is only one frame.
    """
    mirrored = (MIRROR_PREFIX + name, mirror_positions(positions, skeleton), [mirror(caption) for caption in captions])
    # Both are checked before one is written, so that no clip is without its twin.
    pair = []
    for twin, joints, said in ((name, positions, captions), *([mirrored] if twins else [])):
        features = features_from_positions(joints, skeleton)
        if len(features) == 0 or not np.all(np.isfinite(features)):
            raise UserError(f"{twin}: no finite features; the clip has fewer than two frames or a bone without length")
        pair.append((twin, features, said))
    for twin, features, said in pair:
        write_clip(folder, twin, features, captions=said, skeleton=skeleton)
    return len(features)


def mirror(caption: Caption) -> Caption:
    """Returns the caption of the mirrored motion: left and right are exchanged in text and tokens."""
    text = mirror_caption(caption.text)
    if caption.tokens == tag_words(caption.text):
        return caption._replace(text=text, tokens=tag_words(text))
    # Tokens of another tagger, word by word: "left/VERB the/DET stage/NOUN" has no side if its text has none.
    tokens = caption.tokens if text == caption.text else tuple(map(mirror_caption, caption.tokens))
    return caption._replace(text=text, tokens=tokens)


def with_twins(names: Sequence[str]) -> list[str]:
    """Returns the names, each followed by its mirrored twin. Both are always in the same split."""
    return [twin for name in names for twin in (name, MIRROR_PREFIX + name)]


def finish_folder(
    folder: str | Path, splits: Mapping[str, Sequence[str]], *, info: DatasetInfo, skeleton: Skeleton
) -> dict[str, int]:
    """Writes split lists, statistics and `dataset.yaml`, and returns the sizes of the splits.

    The statistics are those of the training clips. HumanML3D's published statistics include the test clips, but a model
    that is measured on the test split should not know even its mean.

    Raises:
        UserError: The training split is empty.
    """
    folder = Path(folder)
    # Statistics are those of this split, so nothing could be normalized.
    if not splits.get("train"):
        raise UserError(f"{info.name}: no clip is left for training; check the split lists and the captions")
    for split in SPLITS:
        save_text(folder / f"{split}.txt", "".join(f"{name}\n" for name in splits.get(split, ())))
    clips = (np.load(folder / FEATURES / f"{name}.npy") for name in splits["train"])
    save_normalizer(folder, normalizer_from_clips(clips, skeleton.layout))
    save_config(folder / INFO, info)
    return {split: len(splits.get(split, ())) for split in SPLITS}
