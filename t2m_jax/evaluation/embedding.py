"""Real and generated motions, and captions, in the evaluator's space, in large batches on the device."""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from t2m_jax.checkpoints.bundle import BundleConfig
from t2m_jax.checkpoints.evaluator import TrainedEvaluator
from t2m_jax.data.folder import Clip
from t2m_jax.masks import mask_from_lengths
from t2m_jax.models.evaluator import Evaluator, EvaluatorConfig
from t2m_jax.models.vqvae import VqVae
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.sampling.decoding import CHUNK
from t2m_jax.sampling.pipeline import TextToMotion, generate_codes
from t2m_jax.sampling.strategies import Strategy

CODE_BATCH, MOTION_BATCH = 128, 128
"""Motions whose codes are drawn at a time, and that are decoded and embedded at a time."""
FRAME_BUCKET = 32
"""Batches of motion are as long as their longest, rounded up to this, so that few lengths are compiled."""
ROOM = 4
"""Frames of nothing behind the longest motion: what the evaluator's last movement looks at."""
EMPTY_CODE = 1
"""What a generation that ends at once counts as, as in T2M-GPT's code."""


class GeneratedCodes(NamedTuple):
    """Codes of many motions, 0 past their ends."""

    codes: Int[np.ndarray, "B N"]
    code_lengths: Int[np.ndarray, " B"]


def _batches(count: int, size: int) -> list[np.ndarray]:
    """Returns rows in batches of one size; the last is filled up with its first row."""
    rows = np.arange(count)
    return [np.resize(rows[first : first + size], size) if first + size > count else rows[first : first + size]
            for first in range(0, count, size)]  # fmt: skip


def generate_many(
    model: TextToMotion,
    text_embedding: Float[np.ndarray, "B E"],
    keys: Key[Array, " B"],
    *,
    strategy: Strategy,
    lengths: Int[np.ndarray, " B"] | None,
) -> GeneratedCodes:
    """Returns codes of one motion a row, until the model ends them or, with `lengths` (frames), as long as those.

    Most motions are short, and a batch takes as long as its longest: all are drawn up to half the length first, and
    those that have not ended once more as a whole. As they depend on text and key alone they begin as they did.
    """
    config, longest = model.config, model.config.gpt.max_codes
    codes = np.zeros((len(text_embedding), longest), np.int32)
    code_lengths = np.zeros(len(text_embedding), np.int32)

    def draw(chosen: Int[np.ndarray, " C"], *, min_codes: int, max_codes: int) -> None:
        for batch in _batches(len(chosen), CODE_BATCH):
            rows = chosen[batch]
            drawn = generate_codes(
                model.variables,
                jnp.asarray(text_embedding[rows]),
                keys[rows],
                config=config,
                strategy=strategy,
                min_codes=min_codes,
                max_codes=max_codes,
            )
            codes[rows, :max_codes], code_lengths[rows] = np.asarray(drawn.codes), np.asarray(drawn.code_lengths)

    if lengths is not None:
        draw(np.arange(len(codes)), min_codes=longest, max_codes=longest)
        code_lengths = np.clip(lengths // config.vqvae.downsample, 1, longest).astype(np.int32)
    else:
        half = max(longest // 2 // CHUNK * CHUNK, 1)
        draw(np.arange(len(codes)), min_codes=0, max_codes=half)
        draw(np.flatnonzero(code_lengths == half), min_codes=0, max_codes=longest)
    codes[code_lengths == 0, 0] = EMPTY_CODE
    return GeneratedCodes(codes, np.maximum(code_lengths, 1))


@functools.partial(jax.jit, static_argnames=("config", "evaluator", "max_frames", "clear"))
def embed_codes(
    variables: tuple[Any, Any],
    statistics: tuple[Normalizer, Normalizer],
    codes: Int[Array, "B N"],
    code_lengths: Int[Array, " B"],
    *,
    config: BundleConfig,
    evaluator: EvaluatorConfig,
    max_frames: int,
    clear: bool,
) -> Float[Array, "B E"]:
    """Returns the embeddings of decoded codes; variables and statistics are those of model and evaluator.

    Motions longer than `max_frames` are cut there. With `clear` what the decoder made past a motion's end is zero.
    """
    vqvae_variables, evaluator_variables = variables
    ours, theirs = statistics
    mask = mask_from_lengths(code_lengths, codes.shape[1])
    decoded = VqVae(config.vqvae).apply(vqvae_variables, codes, mask, method="decode")
    motion = theirs.normalize(ours.denormalize(decoded))[:, :max_frames]
    lengths = jnp.minimum(code_lengths * config.vqvae.downsample, max_frames)
    motion = jnp.pad(motion, ((0, 0), (0, min(ROOM, max_frames - motion.shape[1])), (0, 0)))
    if clear:
        motion = jnp.where(mask_from_lengths(lengths, motion.shape[1])[:, :, None], motion, 0.0)
    return Evaluator(evaluator).apply(evaluator_variables, motion, lengths, method="embed_motion")


def embed_generated(
    model: TextToMotion, evaluator: TrainedEvaluator, generated: GeneratedCodes, *, max_frames: int, clear: bool
) -> Float[np.ndarray, "B E"]:
    """Returns the embeddings of generated motions, decoded in batches of like length."""
    order = np.argsort(generated.code_lengths, kind="stable")
    embeddings = np.zeros((len(order), evaluator.config.embedding_dim), np.float32)
    bucket = max(FRAME_BUCKET // model.config.vqvae.downsample, 1)
    for rows in _batches(len(order), MOTION_BATCH):
        chosen = order[rows]
        longest = -(-int(generated.code_lengths[chosen].max()) // bucket) * bucket
        size = min(longest, generated.codes.shape[1])
        embeddings[chosen] = embed_codes(
            (model.variables["vqvae"], evaluator.variables),
            (_on_device(model.normalizer), _on_device(evaluator.normalizer)),
            jnp.asarray(generated.codes[chosen, :size]),
            jnp.asarray(generated.code_lengths[chosen]),
            config=model.config,
            evaluator=evaluator.config,
            max_frames=max_frames,
            clear=clear,
        )
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
    for rows in _batches(len(order), MOTION_BATCH):
        chosen = order[rows]
        longest = -(-int(lengths[chosen].max()) // FRAME_BUCKET) * FRAME_BUCKET
        size = min(longest + ROOM, max_frames)
        motion = np.zeros((MOTION_BATCH, size, evaluator.config.feature_dim), np.float32)
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
    for rows in _batches(len(captions), MOTION_BATCH):
        columns = (jnp.asarray(column[rows]) for column in ids)
        embeddings[rows] = _embed_text(evaluator.variables, *columns, config=evaluator.config)
    return embeddings
