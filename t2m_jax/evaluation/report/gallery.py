"""One repeat, motion by motion: lengths, codes, ranks, and motions to look at."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.evaluation.embedding import embed_decoded, embed_plan_captions, embed_plan_motions
from t2m_jax.evaluation.sources import CodeSource, MotionCodes, encode_pieces
from t2m_jax.evaluation.task import EvaluationTask
from t2m_jax.metrics.retrieval import ranks_of_batches
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import Skeleton, skeleton_from_feature_dim
from t2m_jax.sampling.batches import round_up
from t2m_jax.sampling.decode import decode_motions

REPEAT = 0
"""The repeat that is shown."""
NUM_EXAMPLES = 4
"""Captions whose nearest motions are shown."""
NUM_NEAREST = 3
"""Nearest motions of each of them."""
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
    batches: Int[np.ndarray, "M B"]
    """Motions that are ranked together."""
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

    def decode(self, chosen: Sequence[int]) -> list[Motion]:
        """Returns some of the measured motions, decoded together and cut where the evaluator cuts them."""
        codes = self.codes.rows
        motions = decode_motions(self.tokenizer, [codes[index] for index in chosen], skeleton=self.skeleton)
        return [
            dataclasses.replace(
                motion,
                positions=motion.positions[: self.max_frames],
                # They would still have the frames that are cut off.
                features=None,
                codes=None,
                caption=self.captions[index],
            )
            for index, motion in zip(chosen, motions, strict=True)
        ]


class Candidate(NamedTuple):
    """A motion that is shown for a caption; the motion has the caption that it was made for."""

    motion: Motion
    distance: float
    """Distance to the caption that it is shown for."""
    own: bool
    """Whether it was made for this caption."""


class Example(NamedTuple):
    """A caption, and motions to look at: the nearest of its batch, or its own and the real one."""

    caption: str
    rank: int
    """Rank of the caption's own motion, from 1."""
    distance: float
    """Distance to the caption's own motion."""
    motions: tuple[Candidate, ...]


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
    """Drawn captions, each with the nearest motions of its batch."""
    failures: tuple[Example, ...]
    """Captions whose own motion has a bad rank, each with its own motion and the real one."""


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
        batches=batches,
        # The last of equal places: a model with one motion for all captions must not look perfect.
        ranks=np.asarray(ranks.nearer + ranks.tied + 1).ravel()[: len(text)],
    )


def draw_examples(ranked: RankedRepeat, *, seed: int) -> tuple[Example, ...]:
    """Returns captions drawn by the seed, each with the nearest motions of its batch."""
    order = np.random.default_rng(seed).permutation(len(ranked.captions))
    size = ranked.batches.shape[1]
    examples = []
    for index in _distinct(order, ranked.captions, NUM_EXAMPLES):
        batch = ranked.batches[index // size]
        distances = np.linalg.norm(ranked.text[index] - ranked.measured[batch], axis=1)
        # Stable, so that the page is the same each time if distances are equal.
        places = np.argsort(distances, kind="stable")[:NUM_NEAREST]
        candidates = tuple(
            Candidate(motion, float(distances[place]), bool(place == index % size))
            for motion, place in zip(ranked.decode(batch[places].tolist()), places, strict=True)
        )
        examples.append(_example(ranked, index, candidates))
    return tuple(examples)


def find_failures(ranked: RankedRepeat) -> tuple[Example, ...]:
    """Returns the captions whose own motion has the worst rank, the farthest first if ranks are equal."""
    skeleton = ranked.skeleton
    real_distances = np.linalg.norm(ranked.text - ranked.real, axis=1)
    # `lexsort` sorts by its last key first.
    chosen = _distinct(np.lexsort((-ranked.distances, -ranked.ranks)), ranked.captions, NUM_FAILURES)
    failures = []
    for index, measured in zip(chosen, ranked.decode(chosen), strict=True):
        positions = positions_from_features(ranked.pieces[index], skeleton) * np.float32(skeleton.metres_per_unit)
        real = Motion(positions, skeleton.fps, skeleton=skeleton, caption=ranked.captions[index])
        own = Candidate(measured, float(ranked.distances[index]), True)
        failures.append(_example(ranked, index, (own, Candidate(real, float(real_distances[index]), False))))
    return tuple(failures)


def _example(ranked: RankedRepeat, index: int, motions: tuple[Candidate, ...]) -> Example:
    return Example(ranked.captions[index], int(ranked.ranks[index]), float(ranked.distances[index]), motions)


def _distinct(order: Int[np.ndarray, " N"], captions: Sequence[str], count: int) -> list[int]:
    """Returns the first indices of an order that have different captions."""
    chosen: dict[str, int] = {}
    for index in order:
        # Clips that share a caption would be shown as if it were asked several times.
        chosen.setdefault(captions[index], int(index))
    return list(chosen.values())[:count]
