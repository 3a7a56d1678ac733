"""How well a model fills a gap in held-out motion, compared with the real motion and with an interpolation."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from t2m_jax.data.checks import check_feature_dim
from t2m_jax.data.folder import Dataset
from t2m_jax.errors import UserError
from t2m_jax.field_checks import check_seed
from t2m_jax.files.markdown import markdown_table
from t2m_jax.motion.features import bone_vectors, positions_from_bones, positions_from_features
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.sampling.pipeline import TextToMotion

AROUND_SECONDS = 1.0
"""Least motion before and after a gap."""

Positions = Float[np.ndarray, "T J 3"]
"""Meters."""


class GapFigures(NamedTuple):
    """Means over clips, joints and frames."""

    deviation_mm: float
    """At the four frames around the two joins: how far joints are from where their velocity led."""
    velocity_change: float
    """At the same frames, in m/s."""
    acceleration: float
    """In the gap, in m/s^2."""
    acceleration_error: float
    """Difference of a clip's acceleration in the gap from that of the real motion, in m/s^2."""


class InbetweenFigures(NamedTuple):
    """What is in the gaps."""

    real: GapFigures
    generated: GapFigures
    interpolated: GapFigures
    num_clips: int


def evaluate_inbetween(
    model: TextToMotion, dataset: Dataset, *, split: str, seconds: float, num_clips: int, seed: int = 0
) -> InbetweenFigures:
    """Returns the figures of gaps in the middle of clips, which are filled by `model.redo` with the clip's caption.

    Args:
        model: The model.
        dataset: Data set of the model's skeleton.
        split: Split whose clips are used, in an order that depends on the seed.
        seconds: Length of the gaps.
        num_clips: Clips to use; fewer if the split has fewer that are long enough.
        seed: Start of every random choice.

    Raises:
        UserError: The data do not fit the model, no clip is long enough and has a caption, the gap has fewer than three
            frames, or the seed is not from 0 to 2**32 - 1.
    """
    check_seed(seed)
    check_feature_dim(dataset, model.config.tokenizer.feature_dim, reader="the model")
    least = round((seconds + 2 * AROUND_SECONDS) * dataset.skeleton.fps)
    clips = [
        clip._replace(captions=whole)
        for clip in dataset.clips(split, min_frames=least)
        # Captions with times may be about other frames than the gap.
        if (whole := tuple(caption for caption in clip.captions if caption.whole_clip))
    ]
    if not clips:
        raise UserError(f"{dataset.folder}: split {split} has no clip of {least} frames with a caption of all of it")
    # The same clips for every model, so that their figures can be compared.
    order = np.random.default_rng(seed).permutation(len(clips))[:num_clips]
    found = []
    for number in tqdm(order, desc="filling gaps", unit="clip", disable=None):
        features = clips[number].features
        # The first caption, not a drawn one, so that the model is the only difference of two tables.
        caption = clips[number].captions[0].text
        positions = np.asarray(positions_from_features(features, dataset.skeleton)) * dataset.skeleton.metres_per_unit
        motion = Motion(positions, dataset.skeleton.fps, skeleton=dataset.skeleton)
        begin = (motion.seconds - seconds) / 2
        (filled,) = model.redo(motion, (begin, begin + seconds), caption, seed=seed)
        # Where the gap really is: `redo` rounds it to whole rows of codes.
        first, last = filled.part_starts[1:3]
        straight = interpolate_gap(positions, first, last, skeleton=dataset.skeleton)
        candidates = (positions, filled.positions, straight)
        found.append([gap_figures(one, positions, first, last, fps=motion.fps) for one in candidates])
    real, generated, interpolated = (GapFigures(*np.mean(rows, axis=0).tolist()) for rows in zip(*found, strict=True))
    return InbetweenFigures(real, generated, interpolated, len(found))


def interpolate_gap(positions: Positions, first: int, last: int, *, skeleton: Skeleton) -> Positions:
    """Returns a motion whose root and bones go straight from the frame before a gap to the frame after it."""
    ends = positions[[first - 1, last]]
    share = (np.arange(1, last - first + 1) / (last - first + 1))[:, None, None]
    bones = bone_vectors(ends, skeleton)
    # The mean of two directions is shorter than both, so bones would shrink in the middle of the gap.
    turned = unit_vectors((1 - share) * bones[0] + share * bones[1]) * np.linalg.norm(bones[0], axis=-1, keepdims=True)
    root = (1 - share[:, 0]) * ends[0, 0] + share[:, 0] * ends[1, 0]
    middle = positions_from_bones(root, turned, skeleton)
    return np.concatenate([positions[:first], middle, positions[last:]]).astype(np.float32)


def gap_figures(positions: Positions, real: Positions, first: int, last: int, *, fps: float) -> GapFigures:
    """Returns the figures of one clip, whose gap has frames `first` to `last`.

    Raises:
        UserError: The gap has fewer than three frames, so no acceleration.
    """
    if last - first < 3:
        raise UserError(
            f"seconds: the gap would have {last - first} frames, and needs three or more; give more seconds"
        )
    # The second difference is how far a joint is from where its last velocity led.
    changes, real_changes = (np.linalg.norm(np.diff(one, n=2, axis=0), axis=-1) for one in (positions, real))
    joins = [frame - 1 for frame in (first - 1, first, last - 1, last)]  # change t is that of frame t + 1
    deviation = changes[joins].mean()
    gap = slice(first, last - 2)  # of these changes, all three frames are in the gap
    acceleration, expected = (float(one[gap].mean()) * fps**2 for one in (changes, real_changes))
    return GapFigures(1000 * deviation, deviation * fps, acceleration, abs(acceleration - expected))


def format_inbetween(figures: InbetweenFigures) -> str:
    """Returns a table in Markdown."""
    names = (
        "deviation at the joins, mm",
        "change of velocity at the joins, m/s",
        "acceleration in the gap, m/s^2",
        "error of the acceleration, m/s^2",
    )
    lines = [(name, *(f"{value:.2f}" for value in values)) for name, *values in zip(names, *figures[:3], strict=True)]
    return markdown_table((f"{figures.num_clips} clips", "real", "generated", "interpolated"), lines)
