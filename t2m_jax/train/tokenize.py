"""The data set as codes: every clip through the trained VQ-VAE, once, before the GPT trains."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from tokenizers import Tokenizer
from tqdm import tqdm

from t2m_jax.config import UserError
from t2m_jax.data.code_bank import CodeBank
from t2m_jax.data.folder import Clip
from t2m_jax.masks import mask_from_lengths
from t2m_jax.models.vqvae import VqVae
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.text.tokenization import tokenize

BATCH = 64
FRAME_BUCKET = 64
"""Clips are padded to a multiple of this many frames, so that few lengths are compiled."""


@functools.partial(jax.jit, static_argnames="vqvae")
def encode_batch(
    variables: Any, motion: Float[Array, "B T D"], mask: Bool[Array, "B T"], *, vqvae: VqVae
) -> Int[Array, "B N"]:
    """Returns the codes of a batch of normalized motions, 0 past their ends."""
    return vqvae.apply(variables, motion, mask, method="encode")


def encode_motions(
    vqvae: VqVae, variables: Any, motions: Sequence[Float[np.ndarray, "_ D"]]
) -> list[Int[np.ndarray, " _"]]:
    """Returns the codes of each normalized motion, batched by length."""
    codes: list[Int[np.ndarray, " _"]] = [np.zeros(0, np.int32)] * len(motions)
    order = sorted(range(len(motions)), key=lambda index: len(motions[index]))
    for first in tqdm(range(0, len(order), BATCH), desc="encoding", unit="batch", disable=None):
        chosen = order[first : first + BATCH]
        lengths = np.zeros(BATCH, np.int32)
        lengths[: len(chosen)] = [len(motions[index]) for index in chosen]
        size = -(-int(lengths.max()) // FRAME_BUCKET) * FRAME_BUCKET
        batch = np.zeros((BATCH, size, motions[chosen[0]].shape[1]), np.float32)
        for row, index in enumerate(chosen):
            batch[row, : lengths[row]] = motions[index]
        mask = mask_from_lengths(jnp.asarray(lengths), size)
        found = np.asarray(encode_batch(variables, jnp.asarray(batch), mask, vqvae=vqvae))
        for row, index in enumerate(chosen):
            codes[index] = found[row, : lengths[row] // vqvae.config.downsample]
    return codes


def make_code_bank(
    samples: Sequence[Clip],
    normalizer: Normalizer,
    encode: Any,
    tokenizer: Tokenizer,
    *,
    downsample: int,
    max_caption_tokens: int,
) -> CodeBank:
    """Returns samples as codes, at each of `downsample` starting frames, with their tokenized captions.

    Args:
        samples: Motions (raw features), each with captions that describe all of it.
        normalizer: Statistics the VQ-VAE was trained with.
        encode: Normalized motions to codes.
        tokenizer: Caption tokenizer.
        downsample: Frames a code covers.
        max_caption_tokens: Longest caption in tokens.
    """
    if not samples:
        raise UserError("no motion with a caption to train on: the split is empty or every clip was left out")
    motions = [normalizer.normalize(sample.features) for sample in samples]
    variants = [encode([motion[offset:] for motion in motions]) for offset in range(downsample)]
    lengths = np.array([[len(codes[index]) for codes in variants] for index in range(len(samples))], np.int32)
    codes = np.zeros((len(samples), downsample, max(int(lengths.max()), 1)), np.int32)
    for offset, variant in enumerate(variants):
        for index, row in enumerate(variant):
            codes[index, offset, : len(row)] = row
    counts = np.array([len(sample.captions) for sample in samples], np.int32)
    captions = [caption.text for sample in samples for caption in sample.captions]
    tokens, mask = tokenize(tokenizer, captions, max_length=max_caption_tokens)
    first = np.cumsum(counts, dtype=np.int32) - counts
    return CodeBank(*map(jnp.asarray, (codes, lengths, tokens, mask, first, counts)))
