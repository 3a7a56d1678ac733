"""Motions, real or as codes, and captions in the evaluator's space, in large batches on the device."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from t2m_jax.checkpoints.evaluator import TrainedEvaluator
from t2m_jax.checkpoints.vqvae import TrainedVqVae
from t2m_jax.data.folder import Clip
from t2m_jax.evaluation.batches import batches_of, for_each_batch
from t2m_jax.evaluation.codes import MotionCodes
from t2m_jax.masks import mask_from_lengths
from t2m_jax.models.evaluator import Evaluator, EvaluatorConfig
from t2m_jax.models.vqvae import VqVae, VqVaeConfig
from t2m_jax.motion.normalizer import Normalizer

BATCH = 128
"""Motions that are decoded and embedded at a time."""
FRAME_BUCKET = 32
"""Batches of motion are as long as their longest, rounded up to this, so that few lengths are compiled."""
ROOM = 4
"""Frames of nothing behind the longest motion: what the evaluator's last movement looks at."""


@functools.partial(jax.jit, static_argnames=("config", "evaluator", "max_frames", "clear"))
def embed_codes(
    variables: tuple[Any, Any],
    statistics: tuple[Normalizer, Normalizer],
    codes: Int[Array, "B N"],
    code_lengths: Int[Array, " B"],
    *,
    config: VqVaeConfig,
    evaluator: EvaluatorConfig,
    max_frames: int,
    clear: bool,
) -> Float[Array, "B E"]:
    """Returns the embeddings of decoded codes; variables and statistics are those of VQ-VAE and evaluator.

    Motions longer than `max_frames` are cut there. With `clear` what the decoder made past a motion's end is zero.
    """
    vqvae_variables, evaluator_variables = variables
    ours, theirs = statistics
    mask = mask_from_lengths(code_lengths, codes.shape[1])
    decoded = VqVae(config).apply(vqvae_variables, codes, mask, method="decode")
    motion = theirs.normalize(ours.denormalize(decoded))[:, :max_frames]
    lengths = jnp.minimum(code_lengths * config.downsample, max_frames)
    motion = jnp.pad(motion, ((0, 0), (0, min(ROOM, max_frames - motion.shape[1])), (0, 0)))
    if clear:
        motion = jnp.where(mask_from_lengths(lengths, motion.shape[1])[:, :, None], motion, 0.0)
    return Evaluator(evaluator).apply(evaluator_variables, motion, lengths, method="embed_motion")


def embed_decoded(
    vqvae: TrainedVqVae, evaluator: TrainedEvaluator, motions: MotionCodes, *, max_frames: int, clear: bool
) -> Float[np.ndarray, "B E"]:
    """Returns the embeddings of motions given as codes, decoded in batches of like length."""
    order = np.argsort(motions.code_lengths, kind="stable")
    embeddings = np.zeros((len(order), evaluator.config.embedding_dim), np.float32)
    bucket = max(FRAME_BUCKET // vqvae.config.downsample, 1)
    statistics = (_on_device(vqvae.normalizer), _on_device(evaluator.normalizer))

    def embed(chosen: Int[np.ndarray, " B"]) -> None:
        longest = -(-int(motions.code_lengths[chosen].max()) // bucket) * bucket
        codes = np.zeros((BATCH, longest), np.int32)
        size = min(longest, motions.codes.shape[1])
        codes[:, :size] = motions.codes[chosen, :size]
        embeddings[chosen] = embed_codes(
            (vqvae.variables, evaluator.variables),
            statistics,
            jnp.asarray(codes),
            jnp.asarray(motions.code_lengths[chosen]),
            config=vqvae.config,
            evaluator=evaluator.config,
            max_frames=max_frames,
            clear=clear,
        )

    for_each_batch(embed, batches_of(order, BATCH))
    return embeddings


def _on_device(normalizer: Normalizer) -> Normalizer:
    return Normalizer(jnp.asarray(normalizer.mean), jnp.asarray(normalizer.std))


@functools.partial(jax.jit, static_argnames="config")
def _embed_motion(
    variables: Any, motion: Float[Array, "B T D"], lengths: Int[Array, " B"], *, config: EvaluatorConfig
) -> Float[Array, "B E"]:
    return Evaluator(config).apply(variables, motion, lengths, method="embed_motion")


def embed_real(
    evaluator: TrainedEvaluator,
    samples: Sequence[Clip],
    starts: Int[np.ndarray, " N"],
    lengths: Int[np.ndarray, " N"],
    *,
    max_frames: int,
) -> Float[np.ndarray, "N E"]:
    """Returns the embeddings of pieces of real motion: `lengths` frames of each sample from `starts` on."""
    lengths = np.minimum(lengths, max_frames)
    order = np.argsort(lengths, kind="stable")
    embeddings = np.zeros((len(samples), evaluator.config.embedding_dim), np.float32)
    for chosen in batches_of(order, BATCH):
        longest = -(-int(lengths[chosen].max()) // FRAME_BUCKET) * FRAME_BUCKET
        size = min(longest + ROOM, max_frames)
        motion = np.zeros((BATCH, size, evaluator.config.feature_dim), np.float32)
        for row, index in enumerate(chosen):
            piece = samples[index].features[starts[index] : starts[index] + lengths[index]]
            motion[row, : lengths[index]] = evaluator.normalizer.normalize(piece)
        embeddings[chosen] = _embed_motion(
            evaluator.variables, jnp.asarray(motion), jnp.asarray(lengths[chosen], jnp.int32), config=evaluator.config
        )
    return embeddings


@functools.partial(jax.jit, static_argnames="config")
def _embed_text(
    variables: Any,
    words: Int[Array, "B S"],
    parts_of_speech: Int[Array, "B S"],
    lengths: Int[Array, " B"],
    *,
    config: EvaluatorConfig,
) -> Float[Array, "B E"]:
    return Evaluator(config).apply(variables, words, parts_of_speech, lengths, method="embed_text")


def embed_captions(evaluator: TrainedEvaluator, captions: Sequence[Sequence[str]]) -> Float[np.ndarray, "N E"]:
    """Returns the embeddings of captions, each given as `word/TAG` tokens."""
    ids = evaluator.vocabulary.vectorize_all(captions)
    embeddings = np.zeros((len(captions), evaluator.config.embedding_dim), np.float32)
    for rows in batches_of(np.arange(len(captions)), BATCH):
        columns = (jnp.asarray(column[rows]) for column in ids)
        embeddings[rows] = _embed_text(evaluator.variables, *columns, config=evaluator.config)
    return embeddings
