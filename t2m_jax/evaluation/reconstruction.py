"""How well a VQ-VAE gives back the motion of a split."""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from tqdm import tqdm

from t2m_jax.checkpoints.vqvae import TrainedVqVae
from t2m_jax.data.folder import Dataset
from t2m_jax.errors import UserError
from t2m_jax.masks import mask_from_lengths
from t2m_jax.metrics.codes import code_usage, perplexity
from t2m_jax.metrics.positions import joint_errors
from t2m_jax.models.vqvae import VqVae, VqVaeConfig
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.skeleton import Skeleton

BATCH = 32
FRAME_BUCKET = 64


class ReconstructionReport(NamedTuple):
    """Figures of a reconstruction; the names are those of the JSON file."""

    mpjpe_mm: float
    """Root-aligned mean per-joint position error over all frames, millimetres."""
    mpjpe_median_clip_mm: float
    """The same a clip, median over clips."""
    codebook_usage: float
    """Share of the codes that the split uses."""
    perplexity: float
    """exp of the entropy of code use."""
    num_clips: int
    num_frames: int
    split: str


class ClipResult(NamedTuple):
    """What one batch of clips gives."""

    error_sums: Float[Array, " B"]
    code_counts: Int[Array, " K"]


@functools.partial(jax.jit, static_argnames=("config", "skeleton"))
def reconstruct_batch(
    variables: Any,
    statistics: tuple[Float[Array, " D"], Float[Array, " D"]],
    features: Float[Array, "B T D"],
    mask: Bool[Array, "B T"],
    *,
    config: VqVaeConfig,
    skeleton: Skeleton,
) -> ClipResult:
    """Returns summed joint errors of each clip and how often each code was used; `features` are raw."""
    mean, std = (statistic[None, None] for statistic in statistics)
    output = VqVae(config).apply(variables, (features - mean) / std, mask, train=False)
    reconstruction = positions_from_features(output.reconstruction * std + mean, skeleton)
    reference = positions_from_features(features, skeleton)
    errors = joint_errors(reconstruction, reference)
    return ClipResult(jnp.sum(jnp.where(mask, errors, 0.0), axis=1), output.code_counts.astype(jnp.int32))


def _padded(clips: Sequence[Float[np.ndarray, "_ D"]], downsample: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns a batch cut to whole codes, padded to a bucket of frames, and the lengths."""
    lengths = np.array([len(clip) // downsample * downsample for clip in clips], np.int32)
    size = -(-int(lengths.max()) // FRAME_BUCKET) * FRAME_BUCKET
    batch = np.zeros((BATCH, size, clips[0].shape[1]), np.float32)
    for row, (clip, length) in enumerate(zip(clips, lengths, strict=True)):
        batch[row, :length] = clip[:length]
    return batch, np.pad(lengths, (0, BATCH - len(clips)))


def evaluate_reconstruction(vqvae: TrainedVqVae, dataset: Dataset, *, split: str) -> ReconstructionReport:
    """Returns the figures over every clip of a split, whole, each at its own length.

    Raises:
        UserError: if the data do not fit the model or the split has no clip.
    """
    if dataset.skeleton.feature_dim != vqvae.config.feature_dim:
        raise UserError(
            f"{dataset.folder}: has {dataset.skeleton.feature_dim} features a frame, "
            f"the model reads {vqvae.config.feature_dim}"
        )
    clips = dataset.clips(split, min_frames=vqvae.config.downsample)
    if not clips:
        raise UserError(f"{dataset.folder}: split {split} has no clips to evaluate")
    features = sorted((clip.features for clip in clips), key=len)
    statistics = (jnp.asarray(vqvae.normalizer.mean), jnp.asarray(vqvae.normalizer.std))
    sums, lengths, counts = [], [], np.zeros(vqvae.config.num_codes, np.int64)
    for first in tqdm(range(0, len(features), BATCH), desc="reconstructing", unit="batch", disable=None):
        chosen = features[first : first + BATCH]
        batch, sizes = _padded(chosen, vqvae.config.downsample)
        mask = mask_from_lengths(jnp.asarray(sizes), batch.shape[1])
        result = reconstruct_batch(
            vqvae.variables, statistics, jnp.asarray(batch), mask, config=vqvae.config, skeleton=dataset.skeleton
        )
        sums.append(np.asarray(result.error_sums)[: len(chosen)])
        lengths.append(sizes[: len(chosen)])
        counts += np.asarray(result.code_counts)
    return _report(np.concatenate(sums), np.concatenate(lengths), counts, dataset=dataset, split=split)


def _report(
    sums: Float[np.ndarray, " M"],
    lengths: Int[np.ndarray, " M"],
    counts: Int[np.ndarray, " K"],
    *,
    dataset: Dataset,
    split: str,
) -> ReconstructionReport:
    millimetres = 1000.0 * dataset.skeleton.metres_per_unit
    code_counts = jnp.asarray(counts, jnp.int32)
    return ReconstructionReport(
        mpjpe_mm=float(sums.sum() / lengths.sum() * millimetres),
        mpjpe_median_clip_mm=float(np.median(sums / lengths) * millimetres),
        codebook_usage=float(code_usage(code_counts)),
        perplexity=float(perplexity(code_counts)),
        num_clips=len(lengths),
        num_frames=int(lengths.sum()),
        split=split,
    )
