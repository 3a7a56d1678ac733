"""Motions of one repeat to look at: those nearest to a caption, and those farthest from their own."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.evaluation.codes import MotionCodes
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import Skeleton, skeleton_from_feature_dim
from t2m_jax.sampling.decode import decode_motions

NUM_EXAMPLES, NUM_NEAREST = 4, 3
"""Captions whose nearest motions are shown, and how many of them."""
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
    """Rows that are ranked together."""
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

    def decode(self, rows: Sequence[int]) -> list[Motion]:
        """Returns the measured motions of some rows, decoded together and cut where the evaluator cuts them."""
        codes = self.codes.rows
        motions = decode_motions(self.tokenizer, [codes[row] for row in rows], skeleton=self.skeleton)
        return [
            dataclasses.replace(
                motion,
                positions=motion.positions[: self.max_frames],
                features=None,
                codes=None,
                caption=self.captions[row],
            )
            for row, motion in zip(rows, motions, strict=True)
        ]


class Candidate(NamedTuple):
    """A measured motion that was ranked for a caption; the motion has the caption that it was made for."""

    motion: Motion
    distance: float
    own: bool
    """Whether it was made for this caption."""


class Example(NamedTuple):
    """A caption and the motions of its batch that are nearest to it."""

    caption: str
    rank: int
    """Rank of the caption's own motion, from 1."""
    distance: float
    """Distance to the caption's own motion."""
    nearest: tuple[Candidate, ...]


class Failure(NamedTuple):
    """A caption whose own motion has a bad rank."""

    caption: str
    rank: int
    distance: float
    real_distance: float
    """Distance of the caption to the real motion that it describes."""
    measured: Motion
    real: Motion


def draw_examples(ranked: RankedRepeat, *, seed: int) -> tuple[Example, ...]:
    """Returns captions drawn by the seed, each with the nearest motions of its batch."""
    order = np.random.default_rng(seed).permutation(len(ranked.captions))
    examples, size = [], ranked.batches.shape[1]
    for row in _distinct(order, ranked.captions, NUM_EXAMPLES):
        batch, own = ranked.batches[row // size], row % size
        distances = np.linalg.norm(ranked.text[row] - ranked.measured[batch], axis=1)
        places = np.argsort(distances, kind="stable")[:NUM_NEAREST]
        candidates = tuple(
            Candidate(motion, float(distances[place]), bool(place == own))
            for motion, place in zip(ranked.decode(batch[places].tolist()), places, strict=True)
        )
        examples.append(Example(ranked.captions[row], int(ranked.ranks[row]), float(distances[own]), candidates))
    return tuple(examples)


def find_failures(ranked: RankedRepeat) -> tuple[Failure, ...]:
    """Returns the captions whose own motion has the worst rank, the farthest first if ranks are equal."""
    distances, skeleton = ranked.distances, ranked.skeleton
    real_distances = np.linalg.norm(ranked.text - ranked.real, axis=1)
    chosen = _distinct(np.lexsort((-distances, -ranked.ranks)), ranked.captions, NUM_FAILURES)
    return tuple(
        Failure(
            ranked.captions[row],
            int(ranked.ranks[row]),
            float(distances[row]),
            float(real_distances[row]),
            measured,
            Motion(
                positions_from_features(ranked.pieces[row], skeleton) * np.float32(skeleton.metres_per_unit),
                skeleton.fps,
                skeleton=skeleton,
                caption=ranked.captions[row],
            ),
        )
        for row, measured in zip(chosen, ranked.decode(chosen), strict=True)
    )


def _distinct(order: Int[np.ndarray, " N"], captions: Sequence[str], count: int) -> list[int]:
    """Returns the first rows of an order that have different captions."""
    chosen: dict[str, int] = {}
    for row in order:
        chosen.setdefault(captions[row], int(row))
    return list(chosen.values())[:count]
