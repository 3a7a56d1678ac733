"""What is evaluated: the samples of a split, an evaluator that fits them, a protocol and a seed."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from t2m_jax.checkpoints.evaluator import TrainedEvaluator
from t2m_jax.data.checks import check_feature_dim, check_statistics
from t2m_jax.data.folder import Clip, Dataset, samples_from_clip
from t2m_jax.data.index import load_index
from t2m_jax.devices import put_everywhere
from t2m_jax.errors import UserError
from t2m_jax.evaluation.protocols import Plan, Protocol, make_plan
from t2m_jax.field_checks import check_seed
from t2m_jax.files.arrays import fingerprint
from t2m_jax.models.evaluator import FRAMES_PER_MOVEMENT


class Samples(NamedTuple):
    """The motions of a split, whole or parts, each with captions that describe all of it."""

    clips: Sequence[Clip]
    labels: Int[np.ndarray, " S"] | None
    """What each motion shows, as a number; None if the data set has no labels."""
    shared: int | None
    """Clips left out because their recording is also in training; None if this is not known or was not asked."""


class EvaluationTask(NamedTuple):
    """Everything that the metrics of a set of motions depend on, except the motions."""

    evaluator: TrainedEvaluator
    samples: Samples
    protocol: Protocol
    max_frames: int
    """Longer motions are cut."""
    seed: int
    """Start of every random choice."""
    unit: int = FRAMES_PER_MOVEMENT
    """Lengths of real motion are multiples of this many frames."""
    data: str = ""
    """Name of the data set."""
    split: str = ""
    """Name of the split."""
    contents: str = ""
    """Fingerprint of the data set."""

    def plan(self, repeat: int) -> Plan:
        """Returns what a repeat uses."""
        return make_plan(self.samples.clips, self.protocol, seed=self.seed, repeat=repeat, unit=self.unit)


def make_task(
    dataset: Dataset, evaluator: TrainedEvaluator, protocol: Protocol, *, split: str, seed: int, unit: int
) -> EvaluationTask:
    """Returns the task of evaluating motion on a split.

    Args:
        dataset: The data.
        evaluator: The network that embeds motions and captions.
        protocol: The rules.
        split: Name of the split.
        seed: Start of every random choice.
        unit: The tokenizer's frames per code. Lengths are multiples of it and of the evaluator's frames per movement.

    Raises:
        UserError: The evaluator was trained on other data, the split does not fill a batch, or the seed is not from 0
            to 2**32 - 1.
    """
    check_seed(seed)
    check_feature_dim(dataset, evaluator.config.feature_dim, reader="the evaluator")
    advice = "use the evaluator of this data set, or train one with `t2m train evaluator`"
    check_statistics(dataset, evaluator.normalizer, reader="the evaluator", advice=advice)
    # A tokenizer needs whole codes, and an evaluator whole movements.
    unit = math.lcm(unit, FRAMES_PER_MOVEMENT)
    samples = load_samples(dataset, split, min_frames=unit, source_disjoint=protocol.source_disjoint)
    # Weights from a file are on the host; without this they would be copied to the device with every batch.
    evaluator = evaluator._replace(variables=put_everywhere(evaluator.variables))
    index = load_index(dataset.folder)  # its labels are not in the fingerprint of the data, which training compares
    contents = fingerprint(f"{dataset.fingerprint} {index}", {})
    facts = (dataset.info.max_frames, seed, unit, dataset.info.name, split, contents)
    task = EvaluationTask(evaluator, samples, protocol, *facts)
    try:
        # Only to find out now, and not after a model has generated for an hour, that a split is too small.
        task.plan(repeat=0)
    except UserError as error:
        raise UserError(f"{dataset.folder}: split {split}, {error}") from None
    return task


def load_samples(dataset: Dataset, split: str, *, min_frames: int = 1, source_disjoint: bool = False) -> Samples:
    """Returns the motions of a split that have captions.

    Args:
        dataset: The data.
        split: Name of the split.
        min_frames: Shorter motions are left out.
        source_disjoint: Leave out clips that are cut from a recording that is also in training.

    Raises:
        UserError: There are none.
    """
    clips = dataset.clips(split)
    index = load_index(dataset.folder)
    shared = None
    # Compared with itself, nothing of the training split would be left.
    if source_disjoint and index is not None and index.has("source") and split != "train":
        trained = index.recorded_with((clip.name for clip in clips), dataset.names("train"))
        clips = [clip for clip in clips if clip.name not in trained]
        shared = len(trained)
    pairs = [
        (clip.name, sample)
        for clip in clips
        for sample in samples_from_clip(clip, dataset.info)
        if len(sample.features) >= min_frames
    ]
    if not pairs:
        lengths = f"{dataset.info.min_frames} to {dataset.info.max_frames + 3} frames"
        raise UserError(f"{dataset.folder}: split {split} has no motion of {lengths} with a caption; choose another")
    names, samples = zip(*pairs, strict=True)
    if index is None or not index.has("label"):
        return Samples(samples, None, shared)
    # A clip without a label is its own label: it is like no other.
    labels = [index.label(name) or name for name in names]
    return Samples(samples, np.unique(labels, return_inverse=True)[1].astype(np.int32), shared)
