"""One repeat, motion by motion: lengths, codes, ranks, and motions to look at."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.evaluation.embedding import embed_decoded, embed_plan_captions, embed_plan_motions
from t2m_jax.evaluation.sources import CodeSource, MotionCodes, encode_pieces
from t2m_jax.evaluation.task import EvaluationTask
from t2m_jax.keys import new_key
from t2m_jax.metrics.retrieval import ranks_of_batches
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.skeleton import Skeleton, skeleton_from_feature_dim
from t2m_jax.sampling.batches import round_up
from t2m_jax.sampling.decode import decode_motions

REPEAT = 0
"""The repeat that is shown."""
NUM_EXAMPLES = 4
"""Captions drawn by the seed that are shown."""
NUM_FAILURES = 6
"""Captions with the worst ranks that are shown."""


class RankedRepeat(NamedTuple):
    """A repeat in the evaluator's space: captions, their real motions, and the motions that are measured."""

    tokenizer: TrainedTokenizer
    """Decodes the measured motions."""
    max_frames: int
    """Longer motions are cut."""
    captions: list[str]
    pieces: list[Float[np.ndarray, "_ D"]]
    """Real motion (raw features), as long as it is used."""
    text: Float[np.ndarray, "N E"]
    real: Float[np.ndarray, "N E"]
    measured: Float[np.ndarray, "N E"]
    real_codes: MotionCodes
    codes: MotionCodes
    """Codes of the measured motions."""
    ranks: Int[np.ndarray, " N"]
    """Rank of each caption's own motion in its batch, from 1."""

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of the motions."""
        return skeleton_from_feature_dim(self.tokenizer.config.feature_dim)

    @property
    def distances(self) -> Float[np.ndarray, " N"]:
        """The distance of each caption to its own measured motion."""
        return np.linalg.norm(self.text - self.measured, axis=1)

    def show(self, order: Int[np.ndarray, " N"], count: int) -> "tuple[Example, ...]":
        """Returns the first captions of an order that differ, with their motions, decoded together."""
        chosen: dict[str, int] = {}
        for index in order:
            # Clips that share a caption would be shown as if it were asked several times.
            chosen.setdefault(self.captions[index], int(index))
        indices = list(chosen.values())[:count]
        codes = self.codes.rows
        motions = decode_motions(self.tokenizer, [codes[index] for index in indices], skeleton=self.skeleton)
        real_distances = np.linalg.norm(self.text - self.real, axis=1)
        return tuple(
            Example(
                caption=self.captions[index],
                rank=int(self.ranks[index]),
                distance=float(self.distances[index]),
                real_distance=float(real_distances[index]),
                # Cut where the evaluator cuts it.
                measured=motion.positions[: self.max_frames],
                real=positions_from_features(self.pieces[index], self.skeleton) * self.skeleton.metres_per_unit,
            )
            for index, motion in zip(indices, motions, strict=True)
        )


class Example(NamedTuple):
    """A caption with its own motion and the real one."""

    caption: str
    rank: int
    """Rank of its own motion, from 1."""
    distance: float
    """Distance to its own motion."""
    real_distance: float
    """Distance to the real motion that it describes."""
    measured: Float[np.ndarray, "T J 3"]
    """Meters."""
    real: Float[np.ndarray, "S J 3"]


class RepeatDetails(NamedTuple):
    """One repeat of an evaluation, motion by motion: N motions, K codes."""

    kind: str
    """Where the measured motion comes from: `generated` or `reconstruction`."""
    skeleton: Skeleton
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
    examples: tuple[Example, ...]
    """Captions drawn by the seed."""
    failures: tuple[Example, ...]
    """Captions whose own motion has the worst rank, the farthest first if ranks are equal."""


def gather_details(task: EvaluationTask, source: CodeSource) -> RepeatDetails:
    """Returns the details of the first repeat.

    The motions are made again. They are the same ones, because they depend on the same keys.
    """
    ranked = rank_repeat(task, source)
    config = source.tokenizer.config
    return RepeatDetails(
        kind=source.kind,
        skeleton=ranked.skeleton,
        real_lengths=np.minimum([len(piece) for piece in ranked.pieces], task.max_frames),
        measured_lengths=np.minimum(ranked.codes.code_lengths * config.downsample, task.max_frames),
        real_code_counts=ranked.real_codes.count_codes(config.num_codes),
        measured_code_counts=ranked.codes.count_codes(config.num_codes),
        ranks=ranked.ranks,
        examples=ranked.show(np.random.default_rng(task.seed).permutation(len(ranked.ranks)), NUM_EXAMPLES),
        # `lexsort` sorts by its last key first.
        failures=ranked.show(np.lexsort((-ranked.distances, -ranked.ranks)), NUM_FAILURES),
    )


def rank_repeat(task: EvaluationTask, source: CodeSource) -> RankedRepeat:
    """Returns the first repeat with one motion per caption, the one that counts."""
    plan = task.plan(REPEAT)
    # Without the further samples of each caption, which are only for variety.
    brief = plan._replace(varied=plan.varied[:0])
    key = jax.random.fold_in(new_key(task.seed), REPEAT)
    clips = task.samples.clips
    found = source.make(clips, task.protocol, brief, key)
    text = embed_plan_captions(task, plan)
    measured = embed_decoded(task, source.tokenizer, found.codes).embeddings
    # The last batch is filled with the first motions, as for the metrics.
    batch = task.protocol.batch
    batches = np.resize(np.arange(len(text)), round_up(len(text), batch)).reshape(-1, batch)
    pieces = plan.pieces(clips)
    labels = np.broadcast_to(np.arange(batch), batches.shape)
    ranks = ranks_of_batches(*map(jnp.asarray, (text[batches], measured[batches], labels)))
    return RankedRepeat(
        tokenizer=source.tokenizer,
        max_frames=task.max_frames,
        captions=[caption.text for caption in plan.chosen_captions(clips)],
        pieces=pieces,
        text=text,
        real=embed_plan_motions(task, plan),
        measured=measured,
        real_codes=encode_pieces(source.tokenizer, pieces),
        codes=found.codes,
        # The last of equal places: a model with one motion for all captions must not look perfect.
        ranks=np.asarray(ranks.nearer + ranks.tied + 1).ravel()[: len(text)],
    )
