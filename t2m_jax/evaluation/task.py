"""What motion is evaluated on: the samples of a split, an evaluator that fits them, a protocol and a seed."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Int

from t2m_jax.checkpoints.evaluator import TrainedEvaluator
from t2m_jax.data.folder import Clip, Dataset, samples_from_clip
from t2m_jax.data.index import ClipIndex, load_index
from t2m_jax.errors import UserError
from t2m_jax.evaluation.protocols import Protocol
from t2m_jax.motion.normalizer import Normalizer

STATISTICS_TOLERANCE = 0.5
"""Deviations by which the means of data and evaluator may differ, and natural logarithm of the deviations' ratio."""


class Samples(NamedTuple):
    """The motions of a split, whole or parts, each with captions that describe all of it."""

    clips: Sequence[Clip]
    labels: Int[np.ndarray, " S"] | None
    """What each shows, as a number; None where the data set does not say."""
    shared: int | None
    """Clips left out because their recording is in training, too; None where that is not known or not asked."""


class Subject(NamedTuple):
    """What is looked at, how."""

    evaluator: TrainedEvaluator
    samples: Samples
    protocol: Protocol
    max_frames: int
    seed: int


def make_subject(
    dataset: Dataset, evaluator: TrainedEvaluator, protocol: Protocol, *, split: str, seed: int
) -> Subject:
    """Returns what an evaluation looks at.

    Raises:
        UserError: if the evaluator is not one of such data, or the split has nothing to look at.
    """
    check_fit(evaluator, dataset)
    # Weights from a file are the host's: they would go to the device with every batch.
    evaluator = evaluator._replace(variables=jax.device_put(evaluator.variables))
    samples = load_samples(dataset, split, source_disjoint=protocol.source_disjoint)
    return Subject(evaluator, samples, protocol, dataset.info.max_frames, seed)


def load_samples(dataset: Dataset, split: str, *, source_disjoint: bool = False) -> Samples:
    """Returns the motions of a split; with `source_disjoint` without clips cut from a recording that is in training.

    Raises:
        UserError: if there are none.
    """
    clips, index, shared = dataset.clips(split), load_index(dataset.folder), None
    if source_disjoint and index is not None and index.sources and split != "train":
        trained = index.recorded_with((clip.name for clip in clips), dataset.names("train"))
        clips, shared = [clip for clip in clips if clip.name not in trained], len(trained)
    pairs = [(clip.name, sample) for clip in clips for sample in samples_from_clip(clip, dataset.info)]
    if not pairs:
        raise UserError(f"{dataset.folder}: split {split} has no motion with a caption to evaluate")
    names, samples = zip(*pairs, strict=True)
    return Samples(samples, _labels(names, index), shared)


def _labels(names: Sequence[str], index: ClipIndex | None) -> Int[np.ndarray, " S"] | None:
    """Returns a number for each label; clips without one are alike to none."""
    if index is None or not index.labels:
        return None
    labels = [index.label(name) or name for name in names]
    return np.unique(labels, return_inverse=True)[1].astype(np.int32)


def check_width(what: str, feature_dim: int, dataset: Dataset) -> None:
    """Raises `UserError` where `what` reads other features than the data have."""
    width = dataset.skeleton.feature_dim
    if feature_dim != width:
        raise UserError(f"{dataset.folder}: has {width} features a frame, {what} reads {feature_dim}")


def check_fit(evaluator: TrainedEvaluator, dataset: Dataset) -> None:
    """Raises `UserError` where an evaluator and data are not of one kind of motion.

    An evaluator may have statistics of its own, such as those of an earlier build of the data, but motion must lie
    where it learned to look. Root and contact columns are left out: evaluators weigh them.
    """
    check_width("the evaluator", evaluator.config.feature_dim, dataset)
    layout = dataset.skeleton.layout
    kept = np.r_[layout.positions, layout.rotations, layout.velocities]
    ours, theirs = (Normalizer(*(column[kept] for column in n)) for n in (dataset.normalizer, evaluator.normalizer))
    shift = np.max(np.abs(ours.mean - theirs.mean) / theirs.std)
    ratio = np.max(np.abs(np.log(ours.std / theirs.std)))
    if max(shift, ratio) > STATISTICS_TOLERANCE:
        raise UserError(
            f"{dataset.folder}: its statistics (Mean.npy, Std.npy) are not those of the evaluator's data; train one on "
            "this data set with `t2m train evaluator`"
        )
