"""The codes of the motions that are evaluated: generated from captions, or encoded from real motion."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.data.folder import Clip
from t2m_jax.sampling.batches import batches_of, for_each_batch
from t2m_jax.sampling.decode import pad_codes
from t2m_jax.sampling.loop import CHUNK, Sampling
from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.sampling.programs import encode_motions

BATCH = 128
"""Motions that are generated together."""
EMPTY_CODE = 1
"""The only code of a motion that ends at once, as in T2M-GPT's code."""
MARGIN = 4
"""Rows that a motion may have beyond its expected length before it is generated again."""


class MotionCodes(NamedTuple):
    """Codes of many motions, 0 after their ends."""

    codes: Int[np.ndarray, "B N R"]
    code_lengths: Int[np.ndarray, " B"]
    """Rows of each motion."""

    @property
    def rows(self) -> list[Int[np.ndarray, "_ R"]]:
        """The rows of each motion."""
        return [codes[:length] for codes, length in zip(self.codes, self.code_lengths, strict=True)]

    def count_codes(self, num_codes: int) -> Int[np.ndarray, " K"]:
        """Returns how often each code was used, in all rows and depths."""
        used = np.arange(self.codes.shape[1])[None] < self.code_lengths[:, None]
        return np.bincount(self.codes[used].ravel(), minlength=num_codes)


def generate_many(
    model: TextToMotion,
    text_embedding: Float[np.ndarray, "B E"],
    keys: Key[Array, " B"],
    *,
    sampling: Sampling,
    lengths: Int[np.ndarray, " B"],
    exact: bool = False,
    guidance_scale: float | None = None,
) -> MotionCodes:
    """Returns the codes of one motion per text, at least one row each.

    A batch takes as long as its longest motion. So motions of similar expected length are generated together, up to a
    little more than that length. Those that have not ended by then are generated again, up to the longest length. A
    motion depends on its text and key only, so the second attempt begins like the first.

    Args:
        model: The model.
        text_embedding: One text per motion.
        keys: One key per motion [B]; consumed.
        sampling: How to choose codes; its `max_codes` is the longest motion.
        lengths: Expected frames, such as those of the real motion. They change the time that it takes, not the result.
        exact: Whether each motion gets as many rows as fit into `lengths`; the model does not end it.
        guidance_scale: Strength of the guidance, None for none.
    """
    longest, expected = sampling.max_codes, lengths // model.config.tokenizer.downsample
    codes = np.zeros((len(expected), longest, model.config.tokenizer.num_quantizers), np.int32)
    code_lengths = np.zeros(len(expected), np.int32)
    limits = np.minimum(-(-(expected + MARGIN) // CHUNK) * CHUNK, longest)
    if exact:
        sampling = sampling._replace(min_codes=longest)
    if exact or not sampling.stop_rule.ends_early:
        limits = np.full_like(limits, longest)

    def generate(rows: Int[np.ndarray, " C"]) -> None:
        limits[rows] = limit = int(limits[rows].max())
        text, limited = jnp.asarray(text_embedding[rows]), sampling._replace(max_codes=limit)
        sampled = model.parts.sample_codes(text, keys[rows], limited, guidance_scale=guidance_scale)
        codes[rows, :limit], code_lengths[rows] = sampled.codes, sampled.code_lengths

    for_each_batch(generate, batches_of(np.argsort(limits, kind="stable"), BATCH))
    unfinished = np.flatnonzero((code_lengths == limits) & (limits < longest))
    limits[unfinished] = longest
    for_each_batch(generate, batches_of(unfinished, BATCH))
    codes[code_lengths == 0, 0] = EMPTY_CODE
    code_lengths = np.clip(expected if exact else code_lengths, 1, longest).astype(np.int32)
    codes[np.arange(longest)[None] >= code_lengths[:, None]] = 0
    return MotionCodes(codes, code_lengths)


def encode_pieces(
    tokenizer: TrainedTokenizer,
    samples: Sequence[Clip],
    starts: Int[np.ndarray, " N"],
    lengths: Int[np.ndarray, " N"],
) -> MotionCodes:
    """Returns the codes of pieces of real motion: `lengths` frames of each sample, from `starts` on."""
    pieces = [
        sample.features[start : start + length] for sample, start, length in zip(samples, starts, lengths, strict=True)
    ]
    return MotionCodes(*pad_codes(encode_motions(tokenizer, pieces, progress=False)))
