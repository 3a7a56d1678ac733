"""A data set as large as HumanML3D in minutes: some hundred procedural motions, cut, stretched in time and mirrored.

It has HumanML3D's layout, names, lengths and number of clips and captions, time-tagged captions and broken clips
included, so that whatever the real one needs (time, memory, disk) can be tried without it. Captions speak of the motion
a clip is cut from; it is not meant to be learned from.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from t2m_jax.data.files import FEATURES, TEXTS
from t2m_jax.data.importers.bandai_namco.captions import Labels, write_captions
from t2m_jax.data.importers.bandai_namco.measure import measure
from t2m_jax.data.importers.synthetic import FPS, KINDS, make_motion
from t2m_jax.data.splits import split_by_hash
from t2m_jax.data.texts import Caption, save_captions
from t2m_jax.data.writer import ImportReport, mirror, new_folder, with_twins
from t2m_jax.errors import UserError
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
"""HumanML3D cuts its motions at ten seconds; with this share of longest clips the mean length is its 141 frames."""
TIMED_SHARE = 0.05
"""Captions that speak of a part of the clip."""


class Motion(NamedTuple):
    """A motion that clips are cut from, its mirrored twin and what is said of it."""

    features: Float[np.ndarray, "T D"]
    twin: Float[np.ndarray, "T D"]
    captions: tuple[Caption, ...]


def _make_motions(seed: int, a_kind: int) -> list[Motion]:
    """Returns `a_kind` motions of each kind."""
    motions = []
    for number, kind in enumerate(tqdm(list(KINDS) * a_kind, desc="making motions", unit="motion", disable=None)):
        positions = make_motion(kind, seed=seed * 1_000_003 + number, num_frames=MOTION_FRAMES)
        captions = write_captions(f"{seed} {number}", Labels(kind, "normal"), measure(positions, fps=FPS))
        twin = features_from_positions(mirror_positions(positions, HUMANML3D), HUMANML3D)
        motions.append(Motion(features_from_positions(positions, HUMANML3D), twin, captions))
    return motions


def stretched(
    features: Float[np.ndarray, "S D"], *, start: float, speed: float, num_frames: int
) -> Float[np.ndarray, "T D"]:
    """Returns a stretch of a motion from row `start` on, played at `speed` times its own."""
    layout = HUMANML3D.layout
    rows = start + speed * np.arange(num_frames)
    lower = rows.astype(int)
    share = (rows - lower)[:, None].astype(np.float32)
    result = features[lower] * (1 - share) + features[lower + 1] * share
    for columns in (layout.root_yaw, layout.root_velocity, layout.velocities):
        result[:, columns] *= np.float32(speed)
    result[:, layout.contacts] = np.round(result[:, layout.contacts])
    return result


def _draw_captions(
    captions: tuple[Caption, ...], generator: np.random.Generator, *, seconds: float
) -> tuple[Caption, ...]:
    """Returns three, sometimes four, of the captions; some speak of a part of the clip."""
    count = 4 if generator.random() < 0.08 else 3
    drawn = []
    for index in generator.choice(len(captions), count, replace=False):
        start, end = 0.0, 0.0
        if generator.random() < TIMED_SHARE:
            start, end = np.round(np.sort(generator.uniform(0, seconds, 2)), 1).tolist()
        drawn.append(captions[index]._replace(start=start, end=end))
    return tuple(drawn)


def _cut_twins(
    motion: Motion, generator: np.random.Generator
) -> tuple[Float[np.ndarray, "T D"], Float[np.ndarray, "T D"]]:
    """Returns a stretch of a motion and the same of its twin."""
    longest = generator.random() < LONGEST_SHARE
    num_frames = LONGEST if longest else int(generator.integers(SHORTEST, LONGEST + 1))
    speed = generator.uniform(*SPEEDS)
    start = generator.uniform(0, len(motion.features) - 2 - speed * (num_frames - 1))
    original, twin = (
        stretched(features, start=start, speed=speed, num_frames=num_frames)
        for features in (motion.features, motion.twin)
    )
    return original, twin


def _write_clips(
    folder: Path, names: list[str], motions: list[Motion], *, seed: int
) -> Iterator[Float[np.ndarray, "T D"]]:
    """Yields the features of clips and twins, having written them; one pair is NaN and one has a single row."""
    for number, name in enumerate(tqdm(names, desc="writing clips", unit="pair", disable=None)):
        generator = np.random.default_rng([seed, number])
        motion = motions[generator.integers(len(motions))]
        pair = _cut_twins(motion, generator)
        if number == len(names) // 2:
            pair = (np.full_like(pair[0], np.nan), np.full_like(pair[1], np.nan))
        if number == len(names) // 3:
            pair = (pair[0][:1], pair[1][:1])
        captions = _draw_captions(motion.captions, generator, seconds=len(pair[0]) / FPS)
        mirrored = tuple(mirror(caption) for caption in captions)
        for twin, features, lines in zip(with_twins([name]), pair, (captions, mirrored), strict=True):
            np.save(folder / FEATURES / f"{twin}.npy", features)
            save_captions(folder / TEXTS / f"{twin}.txt", lines)
            yield features


def write_scaled_dataset(
    destination: str | Path, *, num_clips: int = NUM_CLIPS, seed: int = 0, motions_a_kind: int = MOTIONS_A_KIND
) -> ImportReport:
    """Returns what was written after making a data-set folder like HumanML3D's, without positions and `dataset.yaml`.

    Args:
        destination: folder to make.
        num_clips: clips before mirroring.
        seed: another one gives other clips.
        motions_a_kind: how many motions of each kind the clips are cut from.

    Raises:
        UserError: fewer clips than splits need (20), or a destination that exists.
    """
    if num_clips < 20:
        raise UserError(f"--num-clips {num_clips}: at least 20 are needed to fill train, val and test")
    names, frames = [f"{number:06d}" for number in range(num_clips)], 0
    with new_folder(Path(destination)) as folder:
        (folder / FEATURES).mkdir()
        (folder / TEXTS).mkdir()
        motions = _make_motions(seed, motions_a_kind)

        def counted() -> Iterator[Float[np.ndarray, "T D"]]:
            nonlocal frames
            for features in _write_clips(folder, names, motions, seed=seed):
                frames += len(features)
                yield features

        # Over all files, as the published statistics are.
        save_normalizer(folder, normalizer_from_clips(counted(), HUMANML3D.layout))
        splits = {split: with_twins(members) for split, members in split_by_hash([names]).items()}
        lists = splits | {"train_val": splits["train"] + splits["val"], "all": with_twins(names)}
        for split, members in lists.items():
            (folder / f"{split}.txt").write_text("".join(f"{name}\n" for name in members), encoding="utf-8")
    sizes = {split: len(members) for split, members in splits.items()}
    notes = ("one pair of clips is NaN and one has a single frame, as HumanML3D has such",)
    return ImportReport(2 * num_clips, frames, sizes, {}, notes)
