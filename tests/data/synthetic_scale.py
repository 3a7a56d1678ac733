"""A data set as large as HumanML3D in minutes: some hundred procedural motions, cut, stretched in time and mirrored.

It has HumanML3D's layout, names, lengths and numbers of clips and captions, including time-tagged captions and broken
clips. The time, memory and disk space that the real data set needs can be measured without it. The captions describe
the motion that a clip is cut from, so a model cannot learn much from them.

    python -m tests.data.synthetic_scale DEST [NUM_CLIPS [SEED]]
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from t2m_jax.data.captioning.captions import Labels, write_captions
from t2m_jax.data.files import FEATURES, TEXTS
from t2m_jax.data.importers.synthetic import FEWEST_CLIPS, FPS, KINDS, make_motion
from t2m_jax.data.splits import split_by_hash
from t2m_jax.data.texts import Caption, save_captions
from t2m_jax.data.writer import ImportReport, check_count, mirror, new_folder, with_twins
from t2m_jax.field_checks import check_seed
from t2m_jax.files.writing import save_text
from t2m_jax.motion.facts import measure
from t2m_jax.motion.features import features_from_positions
from t2m_jax.motion.mirroring import mirror_positions
from t2m_jax.motion.normalizer import normalizer_from_clips, save_normalizer
from t2m_jax.motion.skeleton import HUMANML3D

NUM_CLIPS = 14_614
"""Clips of HumanML3D before mirroring."""
MOTIONS_A_KIND = 24
MOTION_FRAMES = 360
"""Long enough for the longest clip at the fastest speed."""
SPEEDS = (0.75, 1.5)
SHORTEST, LONGEST = 40, 199
LONGEST_SHARE = 0.27
"""HumanML3D cuts its motions at ten seconds. With this share of longest clips, the mean length is its 141 frames."""
TIMED_SHARE = 0.05
"""Share of the captions that describe a part of the clip."""
FOURTH_CAPTION_SHARE = 0.08
"""Share of the clips with four captions; the others have three."""


class Motion(NamedTuple):
    """A motion that clips are cut from, its mirrored twin and its captions."""

    features: Float[np.ndarray, "T D"]
    twin: Float[np.ndarray, "T D"]
    captions: tuple[Caption, ...]


def stretched(
    features: Float[np.ndarray, "S D"], *, start: float, speed: float, num_frames: int
) -> Float[np.ndarray, "T D"]:
    """Returns a part of a motion from row `start`, played at `speed` times its own speed."""
    layout = HUMANML3D.layout
    rows = start + speed * np.arange(num_frames)
    lower = rows.astype(int)
    share = (rows - lower)[:, None].astype(np.float32)
    result = features[lower] * (1 - share) + features[lower + 1] * share
    for columns in (layout.root_yaw, layout.root_velocity, layout.velocities):
        result[:, columns] *= np.float32(speed)
    result[:, layout.contacts] = np.round(result[:, layout.contacts])
    return result


def _write_clips(
    folder: Path, names: list[str], motions: list[Motion], *, seed: int
) -> Iterator[Float[np.ndarray, "T D"]]:
    """Writes clips and twins and yields their features. As in HumanML3D, one pair is NaN; another has a single row."""
    for number, name in enumerate(tqdm(names, desc="writing clips", unit="pair", disable=None)):
        generator = np.random.default_rng([seed, number])
        motion = motions[generator.integers(len(motions))]
        is_longest = generator.random() < LONGEST_SHARE
        num_frames = LONGEST if is_longest else int(generator.integers(SHORTEST, LONGEST + 1))
        speed = generator.uniform(*SPEEDS)
        start = generator.uniform(0, len(motion.features) - 2 - speed * (num_frames - 1))
        if number == len(names) // 3:
            num_frames = 1
        originals = (motion.features, motion.twin)
        pair = [stretched(whole, start=start, speed=speed, num_frames=num_frames) for whole in originals]
        if number == len(names) // 2:
            pair = [np.full_like(features, np.nan) for features in pair]
        captions = []
        count = 4 if generator.random() < FOURTH_CAPTION_SHARE else 3
        for index in generator.choice(len(motion.captions), count, replace=False):
            begin, end = 0.0, 0.0
            if generator.random() < TIMED_SHARE:
                begin, end = np.round(np.sort(generator.uniform(0, num_frames / FPS, 2)), 1).tolist()
            captions.append(motion.captions[index]._replace(start=begin, end=end))
        said = (captions, [mirror(caption) for caption in captions])
        for twin, features, lines in zip(with_twins([name]), pair, said, strict=True):
            np.save(folder / FEATURES / f"{twin}.npy", features)
            save_captions(folder / TEXTS / f"{twin}.txt", lines)
            yield features


def write_scaled_dataset(
    destination: str | Path, *, num_clips: int = NUM_CLIPS, seed: int = 0, motions_a_kind: int = MOTIONS_A_KIND
) -> ImportReport:
    """Makes a data-set folder like HumanML3D's, without positions and `dataset.yaml`, and returns a report.

    Args:
        destination: Folder to make.
        num_clips: Number of clips before mirroring.
        seed: Another seed gives other clips.
        motions_a_kind: Number of motions of each kind that the clips are cut from.

    Raises:
        UserError: There are fewer clips than the splits need (20), the seed is not from 0 to 2**32 - 1, or the
            destination exists.
    """
    check_count("num-clips", num_clips, least=FEWEST_CLIPS)
    check_seed(seed)
    names, motions, lengths = [f"{number:06d}" for number in range(num_clips)], [], []
    with new_folder(destination, parts=(FEATURES, TEXTS)) as folder:
        kinds = list(KINDS) * motions_a_kind
        for number, kind in enumerate(tqdm(kinds, desc="making motions", unit="motion", disable=None)):
            positions = make_motion(kind, seed=seed * 1_000_003 + number, num_frames=MOTION_FRAMES)
            captions = write_captions(f"{seed} {number}", Labels(kind, "normal"), measure(positions, fps=FPS))
            twin = features_from_positions(mirror_positions(positions, HUMANML3D), HUMANML3D)
            motions.append(Motion(features_from_positions(positions, HUMANML3D), twin, captions))

        def clips() -> Iterator[Float[np.ndarray, "T D"]]:
            for features in _write_clips(folder, names, motions, seed=seed):
                lengths.append(len(features))
                yield features

        # Over all files, like the published statistics.
        save_normalizer(folder, normalizer_from_clips(clips(), HUMANML3D.layout))
        splits = {split: with_twins(members) for split, members in split_by_hash([names]).items()}
        lists = splits | {"train_val": splits["train"] + splits["val"], "all": with_twins(names)}
        for split, members in lists.items():
            save_text(folder / f"{split}.txt", "".join(f"{name}\n" for name in members))
    sizes = {split: len(members) for split, members in splits.items()}
    notes = ("one pair of clips is NaN and one has a single frame, as in HumanML3D",)
    return ImportReport(2 * num_clips, sum(lengths), sizes, {}, notes)


if __name__ == "__main__":
    write_scaled_dataset(sys.argv[1], **dict(zip(("num_clips", "seed"), map(int, sys.argv[2:]), strict=False)))
