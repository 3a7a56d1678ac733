"""The quality of decoded motion, before and after the clean-up."""

from typing import NamedTuple

from jaxtyping import Array, Float, Int

from t2m_jax.masks import mask_from_lengths
from t2m_jax.metrics.quality import MotionQuality, measure_quality
from t2m_jax.motion.cleanup import clean_positions
from t2m_jax.motion.skeleton import Skeleton

CLEANED = "cleaned_"
"""Prefix of the names of metrics of cleaned motion."""


class DecodedQuality(NamedTuple):
    """Measures of decoded clips."""

    decoded: MotionQuality
    """As decoded; all other metrics of an evaluation measure this motion."""
    cleaned: MotionQuality
    """After the clean-up."""


def measure_decoded(
    positions: Float[Array, "B T J 3"], lengths: Int[Array, " B"], *, skeleton: Skeleton
) -> DecodedQuality:
    """Returns the quality of decoded clips, in the skeleton's unit."""
    mask, unit = mask_from_lengths(lengths, positions.shape[1]), skeleton.metres_per_unit
    cleaned = clean_positions(positions * unit, lengths, skeleton=skeleton) / unit
    return DecodedQuality(*[measure_quality(clips, mask, skeleton=skeleton) for clips in (positions, cleaned)])
