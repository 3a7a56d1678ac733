"""Motions of one repeat to look at: what a caption finds, and what is not found."""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from t2m_jax.checkpoints.vqvae import TrainedVqVae
from t2m_jax.evaluation.codes import MotionCodes
from t2m_jax.evaluation.protocols import BATCH
from t2m_jax.masks import mask_from_lengths
from t2m_jax.models.vqvae import VqVae, VqVaeConfig
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.record import Motion
from t2m_jax.motion.skeleton import Skeleton

NUM_EXAMPLES, NUM_NEAREST = 4, 3
"""Captions whose nearest motions are shown, and how many of them."""
NUM_FAILURES = 6
"""Captions shown whose own motion is ranked worst."""


class Ranked(NamedTuple):
    """A repeat in the evaluator's space: captions, their real motions and the motions made for them."""

    captions: list[str]
    pieces: list[Float[np.ndarray, "_ D"]]
    """Real motion (features, raw), as long as it counts."""
    text: Float[np.ndarray, "N E"]
    real: Float[np.ndarray, "N E"]
    made: Float[np.ndarray, "N E"]
    real_codes: MotionCodes
    codes: MotionCodes
    """Of what was made."""
    batches: Int[np.ndarray, "M {BATCH}"]
    """Rows that are ranked together."""
    ranks: Int[np.ndarray, " N"]
    """Of each caption's own made motion in its batch, from 1."""

    @property
    def distances(self) -> Float[np.ndarray, " N"]:
        """Returns how far each caption is from its own made motion."""
        return np.linalg.norm(self.text - self.made, axis=1)


class Candidate(NamedTuple):
    """A made motion as it was ranked for a caption; it bears the caption it was made for."""

    motion: Motion
    distance: float
    own: bool
    """Whether it was made for the very caption."""


class Example(NamedTuple):
    """A caption and the motions of its batch that the evaluator finds nearest."""

    caption: str
    rank: int
    """Of the caption's own motion, from 1."""
    distance: float
    nearest: tuple[Candidate, ...]


class Failure(NamedTuple):
    """A caption whose own motion is far from it."""

    caption: str
    rank: int
    distance: float
    real_distance: float
    """From the caption to the real motion it was written for."""
    made: Motion
    real: Motion


def draw_examples(
    vqvae: TrainedVqVae, ranked: Ranked, skeleton: Skeleton, *, max_frames: int, seed: int
) -> tuple[Example, ...]:
    """Returns captions drawn by the seed, each with the nearest motions of its batch."""
    order = np.random.default_rng(seed).permutation(len(ranked.captions))
    chosen = _distinct(order, ranked.captions, NUM_EXAMPLES)
    distances, nearest = {}, {}
    for row in chosen:
        batch = ranked.batches[row // BATCH]
        distances[row] = np.linalg.norm(ranked.text[row] - ranked.made[batch], axis=1)
        nearest[row] = np.argsort(distances[row], kind="stable")[:NUM_NEAREST]
    shown = [int(ranked.batches[row // BATCH][place]) for row in chosen for place in nearest[row]]
    motions = iter(made_motions(vqvae, ranked, shown, skeleton, max_frames=max_frames))
    return tuple(
        Example(
            ranked.captions[row],
            int(ranked.ranks[row]),
            float(distances[row][row % BATCH]),
            tuple(
                Candidate(next(motions), float(distances[row][place]), bool(place == row % BATCH))
                for place in nearest[row]
            ),
        )
        for row in chosen
    )


def find_failures(vqvae: TrainedVqVae, ranked: Ranked, skeleton: Skeleton, *, max_frames: int) -> tuple[Failure, ...]:
    """Returns the captions whose own motion is ranked worst, among equals the farthest first."""
    distances = ranked.distances
    real_distances = np.linalg.norm(ranked.text - ranked.real, axis=1)
    chosen = _distinct(np.lexsort((-distances, -ranked.ranks)), ranked.captions, NUM_FAILURES)
    motions = made_motions(vqvae, ranked, chosen, skeleton, max_frames=max_frames)
    return tuple(
        Failure(
            ranked.captions[row],
            int(ranked.ranks[row]),
            float(distances[row]),
            float(real_distances[row]),
            motion,
            _motion(ranked.pieces[row], skeleton, ranked.captions[row]),
        )
        for row, motion in zip(chosen, motions, strict=True)
    )


def _distinct(order: Int[np.ndarray, " N"], captions: Sequence[str], count: int) -> list[int]:
    """Returns the first rows of an order that have different captions."""
    chosen: dict[str, int] = {}
    for row in order:
        chosen.setdefault(captions[row], int(row))
        if len(chosen) == count:
            break
    return list(chosen.values())


def made_motions(
    vqvae: TrainedVqVae, ranked: Ranked, rows: Sequence[int], skeleton: Skeleton, *, max_frames: int
) -> list[Motion]:
    """Returns what was made for some rows, decoded together and cut where the evaluator cuts it."""
    codes, code_lengths = (column[list(rows)] for column in ranked.codes)
    decoded = _decode(vqvae.variables, jnp.asarray(codes), jnp.asarray(code_lengths), config=vqvae.config)
    features = vqvae.normalizer.denormalize(np.asarray(decoded))
    frames = np.minimum(code_lengths * vqvae.config.downsample, max_frames)
    return [
        _motion(features[place, :length], skeleton, ranked.captions[row])
        for place, (row, length) in enumerate(zip(rows, frames, strict=True))
    ]


@functools.partial(jax.jit, static_argnames="config")
def _decode(
    variables: Any, codes: Int[Array, "B N"], code_lengths: Int[Array, " B"], *, config: VqVaeConfig
) -> Float[Array, "B T D"]:
    mask = mask_from_lengths(code_lengths, codes.shape[1])
    return VqVae(config).apply(variables, codes, mask, method="decode")


def _motion(features: Float[np.ndarray, "T D"], skeleton: Skeleton, caption: str) -> Motion:
    positions = np.asarray(positions_from_features(features, skeleton)) * np.float32(skeleton.metres_per_unit)
    return Motion(positions, skeleton.fps, skeleton=skeleton, caption=caption)
