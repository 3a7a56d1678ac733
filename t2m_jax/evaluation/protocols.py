"""Evaluation protocols by name: which pieces of which clips a repeat looks at, with which captions, in which batches.

Three are the field's, after its codes (which the papers do not say alike); `strict` is ours. What they draw is
drawn here from a seed, so a repeat is a function of data, protocol, seed and number.
"""

import dataclasses
from collections.abc import Sequence
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from t2m_jax.data.banks.captions import SHORTER_CHANCE, used_lengths
from t2m_jax.data.folder import Clip
from t2m_jax.errors import UserError
from t2m_jax.models.evaluator import FRAMES_PER_MOVEMENT

BATCH = 32
"""Pairs that texts and motions are ranked among."""
UNIT = FRAMES_PER_MOVEMENT
"""Lengths are multiples of it."""
SAMPLES_A_CAPTION = 30
"""Motions generated for a caption whose variety is measured."""
MULTIMODALITY_PAIRS = 10
DIVERSITY_PAIRS, FEW_DIVERSITY_PAIRS = 300, 100


@dataclasses.dataclass(frozen=True, kw_only=True)
class Protocol:
    """What one way of evaluating fixes."""

    name: str
    """What it is called in every result."""
    captions: Literal["one", "all"] = "one"
    """For each motion one of its captions, drawn, or each of them."""
    crops: bool = True
    """Whether a third of the motions lose four frames, and motions start at a drawn frame."""
    keeps_tail: bool = False
    """Whether the motions that do not fill a batch count, too."""
    generated_length: Literal["model", "real"] = "model"
    """Who says how long a generated motion is: the model, or the motion it is compared with."""
    clears_past_end: bool = True
    """Whether generated frames past the end are set to zero, or what the decoder made is left there. Ours masks
    what lies past the end while it decodes, so it is not the same as what another decoder leaves."""
    multimodality_captions: int | None = None
    """Captions whose variety is measured; None is all of them, 0 leaves that metric out."""
    source_disjoint: bool = False
    """Whether clips are left out whose recording is in training, too, where the data set's index tells."""
    first_counts: bool = True
    """Whether the first of a caption's samples stands for it in the other metrics, or the last."""


PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        Protocol(name="t2m-gpt"),
        Protocol(name="text-to-motion", multimodality_captions=100),
        Protocol(
            name="momask",
            generated_length="real",
            clears_past_end=False,
            multimodality_captions=3 * BATCH,
            first_counts=False,
        ),
        Protocol(name="strict", captions="all", crops=False, keeps_tail=True, source_disjoint=True),
    )
}


def find_protocol(name: str) -> Protocol:
    """Returns a protocol by name.

    Raises:
        UserError: if there is none of that name.
    """
    if name not in PROTOCOLS:
        raise UserError(f"protocol: {name!r} is unknown; known: {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]


class Plan(NamedTuple):
    """One repeat: N motions, each a piece of a sample with one caption, batch by batch."""

    samples: Int[np.ndarray, " N"]
    """Whose motion, as a number among the samples."""
    captions: Int[np.ndarray, " N"]
    """Which of the sample's captions."""
    starts: Int[np.ndarray, " N"]
    """First frame."""
    lengths: Int[np.ndarray, " N"]
    """Frames, a multiple of `UNIT`."""
    varied: Int[np.ndarray, " M"]
    """Which of the N captions are used to measure variety."""
    diversity_pairs: Int[np.ndarray, "P 2"]
    """Motions whose distance counts."""
    multimodality_pairs: Int[np.ndarray, "Q 2"]
    """Samples of a caption whose distance counts, the same for every caption."""


def make_plan(samples: Sequence[Clip], protocol: Protocol, *, seed: int, repeat: int) -> Plan:
    """Returns what a repeat looks at.

    Args:
        samples: Motions of the split, whole or parts, each with captions that describe all of it.
        protocol: The rules.
        seed: Start of every random choice.
        repeat: Number of the repeat.

    Raises:
        UserError: if there are fewer motions than one batch.
    """
    generator = np.random.default_rng([seed, repeat])
    owners, captions = _items(samples, protocol, generator)
    count = len(owners) if protocol.keeps_tail else len(owners) // BATCH * BATCH
    if count < BATCH:
        raise UserError(f"protocol {protocol.name}: {len(owners)} motions with captions do not fill a batch of {BATCH}")
    owners, captions = owners[:count], captions[:count]
    frames = np.array([len(samples[owner].features) for owner in owners])
    shorter = generator.random(count) < SHORTER_CHANCE if protocol.crops else np.zeros(count, bool)
    lengths = np.asarray(used_lengths(jnp.asarray(frames), jnp.asarray(shorter), unit=UNIT))
    starts = generator.integers(0, frames - lengths + 1) if protocol.crops else np.zeros(count, np.int64)
    wanted = protocol.multimodality_captions
    varied = count if wanted is None else min(wanted, count)
    pairs = DIVERSITY_PAIRS if count > DIVERSITY_PAIRS else min(FEW_DIVERSITY_PAIRS, count - 1)
    return Plan(
        owners,
        captions,
        starts,
        lengths,
        np.sort(generator.choice(count, varied, replace=False)),
        _pairs(generator, count, pairs),
        _pairs(generator, SAMPLES_A_CAPTION, MULTIMODALITY_PAIRS),
    )


def _items(
    samples: Sequence[Clip], protocol: Protocol, generator: np.random.Generator
) -> tuple[Int[np.ndarray, " N"], Int[np.ndarray, " N"]]:
    """Returns whose motion and which caption each item is, in the order of the batches."""
    counts = np.array([len(sample.captions) for sample in samples])
    order = generator.permutation(len(samples))
    if protocol.captions == "one":
        return order, generator.integers(0, counts[order])
    # By rounds: first every motion with its first caption, so that a batch holds few motions twice.
    pairs = [
        (owner, caption) for caption in range(max(counts, default=0)) for owner in order if caption < counts[owner]
    ]
    owners, captions = np.array(pairs).reshape(-1, 2).T
    return owners, captions


def _pairs(generator: np.random.Generator, count: int, number: int) -> Int[np.ndarray, "P 2"]:
    """Returns pairs of two draws without replacement each, made one after the other: a pair may be one and the same."""
    return np.stack([generator.choice(count, number, replace=False) for _ in range(2)], axis=1)
