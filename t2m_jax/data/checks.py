"""Whether a data set and a trained model fit each other."""

from collections import Counter
from typing import NamedTuple

import numpy as np

from t2m_jax.data.files import INFO, MIRROR_PREFIX
from t2m_jax.data.folder import Dataset, DatasetInfo
from t2m_jax.errors import UserError
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import Skeleton

STATISTICS_TOLERANCE = 0.5
"""Largest allowed `StatisticsDifference` between a model and the data that it is used with.

The statistics that are published with T2M-GPT's weights differ from those of HumanML3D by up to 0.23, because they were
measured on another build of the data.
"""


class StatisticsDifference(NamedTuple):
    """The largest differences between two statistics over the compared columns."""

    shift: float
    """Difference of two means, in standard deviations."""
    ratio: float
    """Difference of the logarithms of two standard deviations."""


def compare_statistics(
    normalizer: Normalizer, reference: Normalizer, columns: slice | np.ndarray = slice(None)
) -> StatisticsDifference:
    """Returns the difference between two statistics, in standard deviations of `reference`."""
    mean, std, other_mean, other_std = (np.asarray(part)[columns] for part in (*normalizer, *reference))
    shift = np.max(np.abs(mean - other_mean) / other_std)
    # In logarithms, twice and half the deviation are equally different.
    return StatisticsDifference(float(shift), float(np.max(np.abs(np.log(std / other_std)))))


def check_overlap(splits: dict[str, tuple[str, ...]]) -> list[str]:
    """Returns the clips that are in two lists or twice in one. A clip and its mirrored twin count as one."""
    problems = []
    home: dict[str, str] = {}
    for split, names in splits.items():
        problems += [f"{split}.txt: names {name} {count} times" for name, count in Counter(names).items() if count > 1]
        # A model that was trained with a twin knows the clip.
        for original in sorted({name.removeprefix(MIRROR_PREFIX) for name in names}):
            if original in home:
                problems.append(f"{split}.txt: {original} or its mirrored twin is in {home[original]}.txt, too")
            home.setdefault(original, split)
    return problems


def check_rate(info: DatasetInfo, skeleton: Skeleton) -> list[str]:
    """Returns whether a data set has another frame rate than its skeleton, at which models show all motion."""
    if info.fps == skeleton.fps:
        return []
    return [
        f"{INFO}: fps: {info.fps:g}, but features of skeleton {skeleton.name} have {skeleton.fps:g} frames per second, "
        "and models show them so; correct it, or import the motion again"
    ]


def check_feature_dim(dataset: Dataset, feature_dim: int, *, reader: str) -> None:
    """Raises `UserError` if a data set does not have the feature width that a model reads.

    Args:
        dataset: The data.
        feature_dim: Feature width that the model reads.
        reader: The model in the error message, such as "the evaluator".
    """
    found = dataset.skeleton.feature_dim
    if found != feature_dim:
        raise UserError(
            f"{dataset.folder}: has {found} features per frame, but {reader} reads {feature_dim}; "
            f"use data on the same skeleton, or a model with feature_dim {found}"
        )


def find_difference(dataset: Dataset, normalizer: Normalizer, *, reader: str) -> str | None:
    """Returns a sentence about how the statistics of a data set and of a model differ, or None if they are alike.

    Small differences are allowed (`STATISTICS_TOLERANCE`). The root's columns and the contacts are not compared,
    because training weights them.

    Args:
        dataset: The data.
        normalizer: The statistics of the model.
        reader: The model in the sentence, such as "the evaluator".

    Raises:
        UserError: The model reads another feature width.
    """
    check_feature_dim(dataset, len(normalizer.mean), reader=reader)
    layout = dataset.skeleton.layout
    compared = np.r_[layout.positions, layout.rotations, layout.velocities]
    difference = compare_statistics(dataset.normalizer, normalizer, compared)
    if max(difference) <= STATISTICS_TOLERANCE:
        return None
    return (
        f"{dataset.folder}: its statistics (Mean.npy, Std.npy) differ too much from those of {reader} (means by up "
        f"to {difference.shift:.2g} deviations, deviations by a factor of up to {np.exp(difference.ratio):.2g})"
    )


def check_statistics(dataset: Dataset, normalizer: Normalizer, *, reader: str, advice: str) -> None:
    """Raises `UserError` if a model was trained with statistics of a different kind of motion (`find_difference`).

    Args:
        dataset: The data.
        normalizer: The statistics of the model.
        reader: The model in the error message, such as "the evaluator".
        advice: What the user can do about it.
    """
    difference = find_difference(dataset, normalizer, reader=reader)
    if difference is not None:
        raise UserError(f"{difference}; {advice}")
