"""Motions as codes: whole lists through a VQ-VAE's encoder, batched by length."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from tqdm import tqdm

from t2m_jax.checkpoints.vqvae import TrainedVqVae
from t2m_jax.masks import mask_from_lengths
from t2m_jax.models.vqvae import VqVae

BATCH = 64
FRAME_BUCKET = 64
"""Motions are padded to a multiple of this many frames, so that few lengths are compiled."""


@functools.partial(jax.jit, static_argnames="vqvae")
def encode_batch(
    variables: Any, motion: Float[Array, "B T D"], mask: Bool[Array, "B T"], *, vqvae: VqVae
) -> Int[Array, "B N"]:
    """Returns the codes of a batch of normalized motions, 0 past their ends."""
    return vqvae.apply(variables, motion, mask, method="encode")


def encode_motions(
    vqvae: TrainedVqVae, motions: Sequence[Float[np.ndarray, "_ D"]], *, progress: bool = True
) -> list[Int[np.ndarray, " _"]]:
    """Returns the codes of each motion (raw features), with a bar on a terminal where `progress` is wanted."""
    codes: list[Int[np.ndarray, " _"]] = [np.zeros(0, np.int32)] * len(motions)
    order = sorted(range(len(motions)), key=lambda index: len(motions[index]))
    variables = jax.device_put(vqvae.variables)
    hidden = None if progress else True
    for first in tqdm(range(0, len(order), BATCH), desc="encoding", unit="batch", disable=hidden):
        chosen = order[first : first + BATCH]
        lengths = np.zeros(BATCH, np.int32)
        lengths[: len(chosen)] = [len(motions[index]) for index in chosen]
        size = -(-int(lengths.max()) // FRAME_BUCKET) * FRAME_BUCKET
        batch = np.zeros((BATCH, size, vqvae.config.feature_dim), np.float32)
        for row, index in enumerate(chosen):
            batch[row, : lengths[row]] = vqvae.normalizer.normalize(motions[index])
        mask = mask_from_lengths(jnp.asarray(lengths), size)
        found = np.asarray(encode_batch(variables, jnp.asarray(batch), mask, vqvae=VqVae(vqvae.config)))
        for row, index in enumerate(chosen):
            codes[index] = found[row, : lengths[row] // vqvae.config.downsample]
    return codes
