"""How well a tokenizer gives back the motion of a split."""

import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from tqdm import tqdm

from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.data.checks import check_feature_dim
from t2m_jax.data.folder import Dataset
from t2m_jax.devices import put_everywhere, put_rows
from t2m_jax.errors import UserError
from t2m_jax.evaluation.codes import MotionCodes
from t2m_jax.evaluation.report.record import ReconstructionFigures
from t2m_jax.masks import mask_from_lengths
from t2m_jax.metrics.codes import code_usage, perplexity
from t2m_jax.metrics.positions import joint_errors
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.sampling.batches import pad_motions, round_up
from t2m_jax.sampling.codec import decode_positions, encode_batch

BATCH = 32
"""Clips that are encoded and decoded together."""
FRAME_BUCKET = 64
"""Batches are padded to a multiple of this many frames, so that few programs are compiled."""


class ReconstructedBatch(NamedTuple):
    """A batch of clips after encoding and decoding."""

    error_sums: Float[Array, " B"]
    """Joint error of each clip, summed over its frames, in the skeleton's unit."""
    codes: Int[Array, "B N R"]
    """0 after the end of a clip."""


@functools.partial(jax.jit, static_argnames=("tokenizer", "skeleton"))
def reconstruct_batch(
    variables: Any,
    normalizer: Normalizer,
    features: Float[Array, "B T D"],
    lengths: Int[Array, " B"],
    *,
    tokenizer: Any,
    skeleton: Skeleton,
) -> ReconstructedBatch:
    """Returns errors and codes of raw features; `tokenizer` is the module."""
    mask = mask_from_lengths(lengths, features.shape[1])
    codes = encode_batch(variables, normalizer.normalize(features), mask, tokenizer=tokenizer)
    code_lengths = lengths // (features.shape[1] // codes.shape[1])
    _, positions = decode_positions(variables, normalizer, codes, code_lengths, tokenizer=tokenizer, skeleton=skeleton)
    errors = joint_errors(positions, positions_from_features(features, skeleton))
    return ReconstructedBatch(jnp.sum(jnp.where(mask, errors, 0.0), axis=1), codes)


def evaluate_reconstruction(tokenizer: TrainedTokenizer, dataset: Dataset, *, split: str) -> ReconstructionFigures:
    """Returns the figures over every clip of a split, whole, each at its own length.

    Raises:
        UserError: The data do not fit the tokenizer, or the split has no clips.
    """
    check_feature_dim(dataset, tokenizer.config.feature_dim, reader="the model")
    downsample = tokenizer.config.downsample
    clips = dataset.clips(split, min_frames=downsample)
    if not clips:
        raise UserError(f"{dataset.folder}: split {split} has no clips to evaluate; choose another split")
    features = sorted((clip.features[: len(clip.features) // downsample * downsample] for clip in clips), key=len)
    variables = put_everywhere(tokenizer.variables)
    lengths, sums = np.array([len(clip) for clip in features]), np.zeros(len(features), np.float32)
    counts = np.zeros(tokenizer.config.num_codes, np.int64)
    for first in tqdm(range(0, len(features), BATCH), desc="reconstructing", unit="batch", disable=None):
        chosen = features[first : first + BATCH]
        batch = pad_motions(chosen, batch=BATCH, size=round_up(len(chosen[-1]), math.lcm(FRAME_BUCKET, downsample)))
        result = reconstruct_batch(
            variables,
            tokenizer.normalizer,
            *put_rows(tuple(batch)),
            tokenizer=tokenizer.module,
            skeleton=dataset.skeleton,
        )
        sums[first : first + BATCH] = result.error_sums[: len(chosen)]
        counts += MotionCodes(np.asarray(result.codes), batch.lengths // downsample).count_codes(
            tokenizer.config.num_codes
        )
    millimeters, code_counts = 1000.0 * dataset.skeleton.metres_per_unit, jnp.asarray(counts, jnp.int32)
    return ReconstructionFigures(
        mpjpe_mm=float(sums.sum() / lengths.sum() * millimeters),
        mpjpe_median_clip_mm=float(np.median(sums / lengths) * millimeters),
        codebook_usage=float(code_usage(code_counts)),
        perplexity=float(perplexity(code_counts)),
        num_clips=len(lengths),
        num_frames=int(lengths.sum()),
        split=split,
    )
