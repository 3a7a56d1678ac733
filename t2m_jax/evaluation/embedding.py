"""Motions and captions in the evaluator's space, and the quality of motion, in large batches on the device."""

import functools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from t2m_jax.checkpoints.evaluator import TrainedEvaluator
from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.data.banks.captions import caption_tokens
from t2m_jax.devices import put_everywhere, put_rows
from t2m_jax.evaluation.protocols import Plan
from t2m_jax.evaluation.sources import MotionCodes
from t2m_jax.evaluation.task import EvaluationTask
from t2m_jax.masks import mask_from_lengths
from t2m_jax.metrics.quality import MotionQuality, measure_quality
from t2m_jax.models.evaluator import FRAMES_PER_MOVEMENT, Evaluator, EvaluatorConfig
from t2m_jax.models.rows import apply_compiled
from t2m_jax.motion.cleanup import clean_positions
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import Skeleton, skeleton_from_feature_dim
from t2m_jax.sampling.batches import batches_of, for_each_batch, pad_motions, round_up
from t2m_jax.sampling.programs import decode_batch

BATCH = 128
"""Motions that are decoded and embedded together."""
FRAME_BUCKET = 32
"""Batches of motion are padded to a multiple of this many frames, so that few programs are compiled."""
# Two convolutions of width 4 and stride 2 read three frames past a movement; 4 is the next whole movement.
ROOM = 4
"""Empty frames after the longest motion, which the convolution over the last movement reads."""


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
    mask = mask_from_lengths(lengths, positions.shape[1])
    unit = skeleton.metres_per_unit
    # The limits of the clean-up are in meters.
    cleaned = clean_positions(positions * unit, lengths, skeleton=skeleton) / unit
    return DecodedQuality(*[measure_quality(clips, mask, skeleton=skeleton) for clips in (positions, cleaned)])


class DecodedMotions(NamedTuple):
    """What is measured of motions given as codes."""

    embeddings: Float[np.ndarray, "B E"]
    """Of the evaluator."""
    quality: DecodedQuality
    """Of the joints, for each motion."""


@functools.partial(jax.jit, static_argnames=("tokenizer", "evaluator", "max_frames", "clear"))
def embed_codes(
    variables: tuple[Any, Any],
    statistics: tuple[Normalizer, Normalizer],
    motions: tuple[Int[Array, "B N R"], Int[Array, " B"]],
    *,
    tokenizer: Any,
    evaluator: EvaluatorConfig,
    max_frames: int,
    clear: bool,
) -> tuple[Float[Array, "B E"], DecodedQuality]:
    """Returns the evaluator's embeddings of decoded codes, and the quality of the motions.

    Args:
        variables: The weights of the tokenizer and of the evaluator.
        statistics: The statistics of the tokenizer and of the evaluator.
        motions: Codes of motions, and the number of rows of each.
        tokenizer: The tokenizer's module.
        evaluator: The evaluator's config.
        max_frames: Longer motions are cut.
        clear: Whether decoded frames after the end of a motion are set to zero.
    """
    codes, code_lengths = motions
    decoded = decode_batch(variables[0], statistics[0], codes, code_lengths, tokenizer=tokenizer)
    frames_per_row = decoded.shape[1] // codes.shape[1]
    # The published codes cut generated motion where their tensors end, at 196 frames.
    decoded = decoded[:, :max_frames]
    # The evaluator's own statistics: they weight root and contacts otherwise than the tokenizer's.
    motion = statistics[1].normalize(decoded)
    # The evaluator reads whole movements; a motion of one short row still has one.
    lengths = jnp.clip(code_lengths * frames_per_row, FRAMES_PER_MOVEMENT, max_frames)
    # Not past `max_frames`: motion that fills the published tensors meets the padding of the convolution there, which
    # gives another embedding than zero frames would.
    motion = jnp.pad(motion, ((0, 0), (0, min(ROOM, max_frames - motion.shape[1])), (0, 0)))
    # Zero after the normalization, so this is the mean pose and not a body at the origin.
    if clear:
        motion = jnp.where(mask_from_lengths(lengths, motion.shape[1])[:, :, None], motion, 0.0)
    embeddings = Evaluator(evaluator).apply(variables[1], motion, lengths, method="embed_motion")
    skeleton = skeleton_from_feature_dim(decoded.shape[2])
    # Quality needs no whole movement, so the frames are not rounded up to one.
    shown = jnp.minimum(code_lengths * frames_per_row, decoded.shape[1])
    return embeddings, measure_decoded(positions_from_features(decoded, skeleton), shown, skeleton=skeleton)


def embed_decoded(task: EvaluationTask, tokenizer: TrainedTokenizer, motions: MotionCodes) -> DecodedMotions:
    """Returns the measurements of motions given as codes, decoded in batches of similar length."""
    evaluator = task.evaluator
    count = len(motions.codes)
    embeddings = np.zeros((count, evaluator.config.embedding_dim), np.float32)
    quality = np.zeros((2, len(MotionQuality._fields), count), np.float32)
    # The bucket is in frames, and a row of codes is `downsample` frames.
    bucket = max(FRAME_BUCKET // tokenizer.config.downsample, 1)
    # On the devices once, not once per batch.
    statistics = put_everywhere((tokenizer.normalizer, evaluator.normalizer))
    variables = put_everywhere((tokenizer.variables, evaluator.variables))

    def embed(chosen: Int[np.ndarray, " B"]) -> None:
        longest = round_up(int(motions.code_lengths[chosen].max()), bucket)
        codes = motions.codes[chosen, :longest]
        # The rounded length may be above that of the source's longest motion.
        codes = np.pad(codes, ((0, 0), (0, longest - codes.shape[1]), (0, 0)))
        # Rows that fill the last batch are repeated motions, which write the same result twice.
        embeddings[chosen], quality[:, :, chosen] = embed_codes(
            variables,
            statistics,
            put_rows((codes, motions.code_lengths[chosen])),
            tokenizer=tokenizer.module,
            evaluator=evaluator.config,
            max_frames=task.max_frames,
            clear=task.protocol.clears_past_end,
        )

    # Neighbors in this order have similar lengths, so that little of a batch is padding.
    for_each_batch(embed, batches_of(np.argsort(motions.code_lengths, kind="stable"), BATCH))
    return DecodedMotions(embeddings, DecodedQuality(*[MotionQuality(*measures) for measures in quality]))


def _by_length(pieces: Sequence[Float[np.ndarray, "_ D"]]) -> Iterator[tuple[Int[np.ndarray, " B"], int]]:
    """Yields batches of pieces of similar lengths, and the frames to pad each to."""
    lengths = np.array([len(piece) for piece in pieces])
    for chosen in batches_of(np.argsort(lengths, kind="stable"), BATCH):
        yield chosen, round_up(int(lengths[chosen].max()), FRAME_BUCKET)


def embed_pieces(
    evaluator: TrainedEvaluator, pieces: Sequence[Float[np.ndarray, "_ D"]], *, max_frames: int
) -> Float[np.ndarray, "N E"]:
    """Returns the embeddings of real motions (raw features) of at most `max_frames` frames."""
    module = Evaluator(evaluator.config)
    embeddings = np.zeros((len(pieces), evaluator.config.embedding_dim), np.float32)
    for chosen, size in _by_length(pieces):
        # Before the padding, so that what follows the end is zero for the evaluator.
        normalized = [evaluator.normalizer.normalize(pieces[index]) for index in chosen]
        # Here, too, there is no room past `max_frames`; see `embed_codes`.
        batch = pad_motions(normalized, batch=BATCH, size=min(size + ROOM, max_frames))
        inputs = put_rows(tuple(batch))
        embeddings[chosen] = apply_compiled(evaluator.variables, *inputs, module=module, method="embed_motion")
    return embeddings


def embed_captions(evaluator: TrainedEvaluator, captions: Sequence[Sequence[str]]) -> Float[np.ndarray, "N E"]:
    """Returns the embeddings of captions, each given as `word/TAG` tokens."""
    ids = evaluator.vocabulary.vectorize_all(captions)
    module = Evaluator(evaluator.config)
    embeddings = np.zeros((len(captions), evaluator.config.embedding_dim), np.float32)
    # All captions have the same width, so any order will do.
    for chosen in batches_of(np.arange(len(captions)), BATCH):
        inputs = put_rows(tuple(array[chosen] for array in ids))
        embeddings[chosen] = apply_compiled(evaluator.variables, *inputs, module=module, method="embed_text")
    return embeddings


def embed_plan_captions(task: EvaluationTask, plan: Plan) -> Float[np.ndarray, "N E"]:
    """Returns the embeddings of a plan's captions."""
    captions = plan.chosen_captions(task.samples.clips)
    return embed_captions(task.evaluator, [caption_tokens(caption) for caption in captions])


def embed_plan_motions(task: EvaluationTask, plan: Plan) -> Float[np.ndarray, "N E"]:
    """Returns the embeddings of a plan's real motions."""
    pieces = plan.pieces(task.samples.clips, max_frames=task.max_frames)
    return embed_pieces(task.evaluator, pieces, max_frames=task.max_frames)


@functools.partial(jax.jit, static_argnames="skeleton")
def measure_features(
    features: Float[Array, "B T D"], lengths: Int[Array, " B"], *, skeleton: Skeleton
) -> MotionQuality:
    """Returns the quality of raw features."""
    mask = mask_from_lengths(lengths, features.shape[1])
    return measure_quality(positions_from_features(features, skeleton), mask, skeleton=skeleton)


def measure_plan_motions(task: EvaluationTask, plan: Plan) -> MotionQuality:
    """Returns the quality of a plan's real motions, one figure per motion."""
    pieces = plan.pieces(task.samples.clips, max_frames=task.max_frames)
    quality = np.zeros((len(MotionQuality._fields), len(pieces)), np.float32)
    skeleton = skeleton_from_feature_dim(pieces[0].shape[1])
    for chosen, size in _by_length(pieces):
        # Without room at the end: a mask hides it from these measures, which no convolution extends.
        batch = pad_motions([pieces[index] for index in chosen], batch=BATCH, size=size)
        quality[:, chosen] = measure_features(*put_rows(tuple(batch)), skeleton=skeleton)
    return MotionQuality(*quality)
