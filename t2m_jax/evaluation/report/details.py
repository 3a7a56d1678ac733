"""What stands behind the figures of a repeat, to be looked at: lengths, codes, what was found and what was not."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from t2m_jax.evaluation.codes import MotionCodes, encode_pieces
from t2m_jax.evaluation.embedding import embed_decoded
from t2m_jax.evaluation.protocols import BATCH, make_plan
from t2m_jax.evaluation.report.gallery import Example, Failure, Ranked, draw_examples, find_failures
from t2m_jax.evaluation.run import embed_plan_captions, embed_plan_motions
from t2m_jax.evaluation.sources import Maker
from t2m_jax.evaluation.task import Subject
from t2m_jax.metrics.retrieval import partner_ranks
from t2m_jax.motion.skeleton import skeleton_from_feature_dim

REPEAT = 0
"""The repeat that is looked at."""


class Evidence(NamedTuple):
    """One repeat of an evaluation, motion by motion; N motions, K codes. Made motion is what a maker made."""

    row: str
    """What the report calls the made motion: `generated` or `reconstruction`."""
    fps: float
    real_lengths: Int[np.ndarray, " N"]
    """Frames."""
    made_lengths: Int[np.ndarray, " N"]
    real_code_counts: Int[np.ndarray, " K"]
    """How often each code stands for a part of real motion."""
    made_code_counts: Int[np.ndarray, " K"]
    ranks: Int[np.ndarray, " N"]
    """Of each caption's own motion among those made for its batch, from 1; behind those as near."""
    distances: Float[np.ndarray, " N"]
    """From each caption to its own made motion."""
    examples: tuple[Example, ...]
    failures: tuple[Failure, ...]


def gather_evidence(subject: Subject, maker: Maker) -> Evidence:
    """Returns what stands behind the first repeat's figures.

    The motions are made again: they depend on the same keys, and so they are the same.
    """
    ranked = _ranked_repeat(subject, maker)
    num_codes, skeleton = maker.vqvae.config.num_codes, skeleton_from_feature_dim(maker.vqvae.config.feature_dim)
    return Evidence(
        maker.row,
        skeleton.fps,
        np.minimum([len(piece) for piece in ranked.pieces], subject.max_frames),
        np.minimum(ranked.codes.code_lengths * maker.vqvae.config.downsample, subject.max_frames),
        _count_codes(ranked.real_codes, num_codes),
        _count_codes(ranked.codes, num_codes),
        ranked.ranks,
        ranked.distances,
        draw_examples(maker.vqvae, ranked, skeleton, max_frames=subject.max_frames, seed=subject.seed),
        find_failures(maker.vqvae, ranked, skeleton, max_frames=subject.max_frames),
    )


def _ranked_repeat(subject: Subject, maker: Maker) -> Ranked:
    """Returns the repeat with the standing sample of each caption."""
    clips, protocol = subject.samples.clips, subject.protocol
    plan = make_plan(clips, protocol, seed=subject.seed, repeat=REPEAT)
    # Samples whose variety is measured are not looked at.
    alone = plan._replace(varied=plan.varied[:0])
    made = maker.make(clips, protocol, alone, jax.random.fold_in(jax.random.key(subject.seed), REPEAT))
    text = embed_plan_captions(subject, plan)
    motion = embed_decoded(
        maker.vqvae, subject.evaluator, made.codes, max_frames=subject.max_frames, clear=protocol.clears_past_end
    )
    samples = [clips[owner] for owner in plan.samples]
    # The last batch is filled up from the front, as where the metrics are computed.
    batches = np.resize(np.arange(len(text)), -(-len(text) // BATCH) * BATCH).reshape(-1, BATCH)
    ranks = np.asarray(_ranks(jnp.asarray(text[batches]), jnp.asarray(motion[batches])))
    return Ranked(
        [sample.captions[caption].text for sample, caption in zip(samples, plan.captions, strict=True)],
        [
            sample.features[start : start + length]
            for sample, start, length in zip(samples, plan.starts, plan.lengths, strict=True)
        ],
        text,
        embed_plan_motions(subject, plan),
        motion,
        encode_pieces(maker.vqvae, samples, plan.starts, plan.lengths),
        made.codes,
        batches,
        ranks.reshape(-1)[: len(text)],
    )


@jax.jit
def _ranks(text: Float[Array, "M B E"], motion: Float[Array, "M B E"]) -> Int[Array, "M B"]:
    """Returns the rank of each text's own motion, from 1; behind those that are as near."""
    labels = jnp.arange(text.shape[1])
    standing = jax.lax.map(lambda batch: partner_ranks(batch[0], batch[1], labels), (text, motion))
    return standing.nearer + standing.tied + 1


def _count_codes(motions: MotionCodes, num_codes: int) -> Int[np.ndarray, " K"]:
    """Returns how often each code was used."""
    used = np.arange(motions.codes.shape[1])[None] < motions.code_lengths[:, None]
    return np.bincount(motions.codes[used], minlength=num_codes)
