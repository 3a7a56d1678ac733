"""The motions that are evaluated, as codes: drawn by a model from captions, or real ones through a VQ-VAE."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from t2m_jax.checkpoints.vqvae import TrainedVqVae
from t2m_jax.data.folder import Clip
from t2m_jax.evaluation.batches import batches_of, for_each_batch
from t2m_jax.sampling.codec import encode_motions
from t2m_jax.sampling.decoding import CHUNK
from t2m_jax.sampling.pipeline import TextToMotion, generate_codes
from t2m_jax.sampling.strategies import Strategy

BATCH = 128
"""Motions whose codes are drawn at a time."""
EMPTY_CODE = 1
"""What a generation that ends at once counts as, as in T2M-GPT's code."""
MARGIN = 4
"""Codes a generated motion may have more than was expected before it is drawn once more."""


class MotionCodes(NamedTuple):
    """Codes of many motions, 0 past their ends."""

    codes: Int[np.ndarray, "B N"]
    code_lengths: Int[np.ndarray, " B"]


def _draw(
    model: TextToMotion,
    text_embedding: Float[np.ndarray, "B E"],
    keys: Key[Array, " B"],
    *,
    strategy: Strategy,
    min_codes: int,
    max_codes: int,
) -> MotionCodes:
    """Returns the codes of one batch, on the host."""
    drawn = generate_codes(
        model.variables,
        jnp.asarray(text_embedding),
        keys,
        config=model.config,
        strategy=strategy,
        min_codes=min_codes,
        max_codes=max_codes,
    )
    return MotionCodes(np.asarray(drawn.codes), np.asarray(drawn.code_lengths))


def generate_many(
    model: TextToMotion,
    text_embedding: Float[np.ndarray, "B E"],
    keys: Key[Array, " B"],
    *,
    strategy: Strategy,
    expected: Int[np.ndarray, " B"],
) -> MotionCodes:
    """Returns codes of one motion a row, until the model ends them.

    A batch takes as long as its longest. Motions expected to be alike in length are drawn together and a little
    further than that; those that have not ended by then, once more as a whole. As a motion depends on its text and key
    alone it begins as it did: `expected` (frames, such as those of the real motion) changes the time and nothing else.
    """
    longest = model.config.gpt.max_codes
    codes = np.zeros((len(text_embedding), longest), np.int32)
    code_lengths = np.zeros(len(text_embedding), np.int32)
    limits = np.minimum(-(-(expected // model.config.vqvae.downsample + MARGIN) // CHUNK) * CHUNK, longest)

    def draw(rows: Int[np.ndarray, " C"]) -> None:
        limits[rows] = limit = int(limits[rows].max())
        codes[rows, :limit], code_lengths[rows] = _draw(
            model, text_embedding[rows], keys[rows], strategy=strategy, min_codes=0, max_codes=limit
        )

    for_each_batch(draw, batches_of(np.argsort(limits, kind="stable"), BATCH))
    unfinished = np.flatnonzero((code_lengths == limits) & (limits < longest))
    limits[unfinished] = longest
    for_each_batch(draw, batches_of(unfinished, BATCH))
    codes[code_lengths == 0, 0] = EMPTY_CODE
    return MotionCodes(codes, np.maximum(code_lengths, 1))


def generate_at_length(
    model: TextToMotion,
    text_embedding: Float[np.ndarray, "B E"],
    keys: Key[Array, " B"],
    *,
    strategy: Strategy,
    lengths: Int[np.ndarray, " B"],
) -> MotionCodes:
    """Returns codes of one motion a row, as many as `lengths` (frames) have room for, without End."""
    longest = model.config.gpt.max_codes
    codes = np.zeros((len(text_embedding), longest), np.int32)

    def draw(rows: Int[np.ndarray, " C"]) -> None:
        codes[rows], _ = _draw(
            model, text_embedding[rows], keys[rows], strategy=strategy, min_codes=longest, max_codes=longest
        )

    for_each_batch(draw, batches_of(np.arange(len(codes)), BATCH))
    code_lengths = np.clip(lengths // model.config.vqvae.downsample, 1, longest).astype(np.int32)
    codes[np.arange(longest)[None] >= code_lengths[:, None]] = 0
    return MotionCodes(codes, code_lengths)


def encode_pieces(
    vqvae: TrainedVqVae,
    samples: Sequence[Clip],
    starts: Int[np.ndarray, " N"],
    lengths: Int[np.ndarray, " N"],
) -> MotionCodes:
    """Returns the codes of pieces of real motion: `lengths` frames of each sample from `starts` on."""
    pieces = [
        sample.features[start : start + max(length, vqvae.config.downsample)]
        for sample, start, length in zip(samples, starts, lengths, strict=True)
    ]
    found = encode_motions(vqvae, pieces, progress=False)
    code_lengths = np.array([len(codes) for codes in found], np.int32)
    codes = np.zeros((len(found), int(code_lengths.max())), np.int32)
    for row, motion_codes in enumerate(found):
        codes[row, : len(motion_codes)] = motion_codes
    return MotionCodes(codes, code_lengths)
