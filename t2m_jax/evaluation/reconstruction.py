"""How well a tokenizer reconstructs the motion of a split."""

import functools
import math
from collections.abc import Sequence
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
from t2m_jax.evaluation.embedding import DecodedQuality, measure_decoded
from t2m_jax.evaluation.report.record import QualityFigures, ReconstructionFigures
from t2m_jax.evaluation.sources import MotionCodes
from t2m_jax.masks import mask_from_lengths
from t2m_jax.metrics.codes import code_usage, perplexity
from t2m_jax.metrics.quality import MotionErrors, MotionQuality, measure_errors, measure_quality
from t2m_jax.models.rows import apply_compiled
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.sampling.batches import pad_motions, round_up
from t2m_jax.sampling.programs import decode_positions

BATCH = 32
"""Clips that are encoded and decoded together."""
FRAME_BUCKET = 64
"""Batches are padded to a multiple of this many frames, so that few programs are compiled."""


class ReconstructedBatch(NamedTuple):
    """A batch of clips after encoding and decoding."""

    errors: MotionErrors
    real: MotionQuality
    quality: DecodedQuality
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
    """Returns errors, quality and codes of raw features; `tokenizer` is the module."""
    mask = mask_from_lengths(lengths, features.shape[1])
    codes = apply_compiled(variables, normalizer.normalize(features), mask, module=tokenizer, method="encode")
    code_lengths = lengths // (features.shape[1] // codes.shape[1])
    _, positions = decode_positions(variables, normalizer, codes, code_lengths, tokenizer=tokenizer, skeleton=skeleton)
    real = positions_from_features(features, skeleton)
    return ReconstructedBatch(
        errors=measure_errors(positions, real, mask, skeleton=skeleton),
        real=measure_quality(real, mask, skeleton=skeleton),
        quality=measure_decoded(positions, lengths, skeleton=skeleton),
        codes=codes,
    )


def evaluate_reconstruction(
    tokenizer: TrainedTokenizer, dataset: Dataset, *, split: str, fraction: float = 1.0
) -> ReconstructionFigures:
    """Returns the figures over every clip of a split, or a fraction of them, whole, each at its own length.

    Raises:
        UserError: The data do not fit the tokenizer, or the split has no clips.
    """
    check_feature_dim(dataset, tokenizer.config.feature_dim, reader="the model")
    downsample = tokenizer.config.downsample
    clips = dataset.clips(split, min_frames=downsample, fraction=fraction)
    if not clips:
        raise UserError(f"{dataset.folder}: split {split} has no clips to evaluate; choose another split")
    # Whole codes, because a tokenizer cannot encode the rest; by length, so that little of a batch is padding.
    features = sorted((clip.features[: len(clip.features) // downsample * downsample] for clip in clips), key=len)
    # On the devices once, not once per batch.
    variables = put_everywhere(tokenizer.variables)
    parts = []
    counts = np.zeros(tokenizer.config.num_codes, np.int64)
    for first in tqdm(range(0, len(features), BATCH), desc="reconstructing", unit="batch", disable=None):
        chosen = features[first : first + BATCH]
        # A multiple of both numbers, so that the padding is whole codes, too.
        batch = pad_motions(chosen, batch=BATCH, size=round_up(len(chosen[-1]), math.lcm(FRAME_BUCKET, downsample)))
        result = reconstruct_batch(
            variables,
            tokenizer.normalizer,
            *put_rows(tuple(batch)),
            tokenizer=tokenizer.module,
            skeleton=dataset.skeleton,
        )
        measures = (result.errors, result.real, *result.quality)
        parts.append([np.asarray(values)[:, : len(chosen)] for values in measures])
        # Rows that fill the last batch have the length 0, so their codes do not count.
        codes = MotionCodes(np.asarray(result.codes), batch.lengths // downsample)
        counts += codes.count_codes(tokenizer.config.num_codes)
    errors, *quality = (np.concatenate(batches, axis=1) for batches in zip(*parts, strict=True))
    lengths = np.array([len(clip) for clip in features])
    return _make_figures(MotionErrors(*errors), quality, lengths, counts, split)


def _make_figures(
    errors: MotionErrors,
    quality: Sequence[Float[np.ndarray, "Q B"]],
    lengths: Int[np.ndarray, " B"],
    code_counts: Int[np.ndarray, " K"],
    split: str,
) -> ReconstructionFigures:
    """Returns the figures of a split from those of its clips; quality of real, decoded and cleaned motion."""
    counts = jnp.asarray(code_counts, jnp.int32)
    real, decoded, cleaned = (
        QualityFigures(**{name: float(row.mean()) for name, row in zip(MotionQuality._fields, measured, strict=True)})
        for measured in quality
    )
    return ReconstructionFigures(
        # Over frames, as MoMask measures it. The other figures are means over clips, long or short.
        mpjpe_mm=1000 * float(errors.mpjpe @ lengths / lengths.sum()),
        mpjpe_median_clip_mm=1000 * float(np.median(errors.mpjpe)),
        codebook_usage=float(code_usage(counts)),
        perplexity=float(perplexity(counts)),
        num_clips=len(lengths),
        num_frames=int(lengths.sum()),
        split=split,
        global_mpjpe_mm=1000 * float(errors.global_mpjpe.mean()),
        acceleration_error_mm=1000 * float(errors.acceleration_error.mean()),
        path_drift_mm=1000 * float(errors.path_drift.mean()),
        heading_drift_degrees=float(errors.heading_drift.mean()),
        real_quality=real,
        quality=decoded,
        cleaned_quality=cleaned,
    )
