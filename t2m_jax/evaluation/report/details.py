"""The motions of one repeat: lengths, codes, and how well each caption finds its motion."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from t2m_jax.evaluation.codes import encode_pieces
from t2m_jax.evaluation.embedding import embed_decoded, embed_plan_captions, embed_plan_motions
from t2m_jax.evaluation.report.gallery import Example, Failure, RankedRepeat, draw_examples, find_failures
from t2m_jax.evaluation.sources import CodeSource
from t2m_jax.evaluation.task import EvaluationTask
from t2m_jax.metrics.retrieval import partner_ranks
from t2m_jax.sampling.batches import round_up

REPEAT = 0
"""The repeat that is shown."""


class RepeatDetails(NamedTuple):
    """One repeat of an evaluation, motion by motion: N motions, K codes."""

    kind: str
    """Where the measured motion comes from: `generated` or `reconstruction`."""
    fps: float
    real_lengths: Int[np.ndarray, " N"]
    """Frames."""
    measured_lengths: Int[np.ndarray, " N"]
    """Frames."""
    real_code_counts: Int[np.ndarray, " K"]
    """How often each code is used by real motion."""
    measured_code_counts: Int[np.ndarray, " K"]
    """How often each code is used by the measured motion."""
    ranks: Int[np.ndarray, " N"]
    """Rank of each caption's own motion in its batch, from 1; motions at the same distance come first."""
    distances: Float[np.ndarray, " N"]
    """Distance of each caption to its own motion."""
    examples: tuple[Example, ...]
    failures: tuple[Failure, ...]


def gather_details(task: EvaluationTask, source: CodeSource) -> RepeatDetails:
    """Returns the details of the first repeat.

    The motions are made again. They are the same ones, because they depend on the same keys.
    """
    ranked = rank_repeat(task, source)
    config = source.tokenizer.config
    return RepeatDetails(
        kind=source.kind,
        fps=ranked.skeleton.fps,
        real_lengths=np.minimum([len(piece) for piece in ranked.pieces], task.max_frames),
        measured_lengths=np.minimum(ranked.codes.code_lengths * config.downsample, task.max_frames),
        real_code_counts=ranked.real_codes.count_codes(config.num_codes),
        measured_code_counts=ranked.codes.count_codes(config.num_codes),
        ranks=ranked.ranks,
        distances=ranked.distances,
        examples=draw_examples(ranked, seed=task.seed),
        failures=find_failures(ranked),
    )


def rank_repeat(task: EvaluationTask, source: CodeSource) -> RankedRepeat:
    """Returns the first repeat with one motion per caption, the one that counts."""
    plan = task.plan(REPEAT)
    # Without the further samples of each caption, which are only for variety.
    brief = plan._replace(varied=plan.varied[:0])
    key = jax.random.fold_in(jax.random.key(task.seed), REPEAT)
    found = source.make(task.samples.clips, task.protocol, brief, key)
    text, measured = embed_plan_captions(task, plan), embed_decoded(task, source.tokenizer, found.codes).embeddings
    samples = [task.samples.clips[owner] for owner in plan.samples]
    # The last batch is filled with the first rows, as for the metrics.
    batch = task.protocol.batch
    batches = np.resize(np.arange(len(text)), round_up(len(text), batch)).reshape(-1, batch)
    return RankedRepeat(
        tokenizer=source.tokenizer,
        max_frames=task.max_frames,
        captions=[sample.captions[caption].text for sample, caption in zip(samples, plan.captions, strict=True)],
        pieces=[
            sample.features[start : start + length]
            for sample, start, length in zip(samples, plan.starts, plan.lengths, strict=True)
        ],
        text=text,
        real=embed_plan_motions(task, plan),
        measured=measured,
        real_codes=encode_pieces(source.tokenizer, samples, plan.starts, plan.lengths),
        codes=found.codes,
        batches=batches,
        ranks=np.asarray(rank_own(jnp.asarray(text[batches]), jnp.asarray(measured[batches]))).ravel()[: len(text)],
    )


@jax.jit
def rank_own(text: Float[Array, "M B E"], motion: Float[Array, "M B E"]) -> Int[Array, "M B"]:
    """Returns the rank of each text's own motion in its batch, from 1; motions at the same distance come first."""
    labels = jnp.arange(text.shape[1])
    standing = jax.lax.map(lambda batch: partner_ranks(batch[0], batch[1], labels), (text, motion))
    return standing.nearer + standing.tied + 1
