"""Evaluation protocols by name: which pieces of which clips a repeat uses, with which captions, in which batches.

Three protocols follow the published codes, which differ from their papers. `t2m-gpt-paper` follows the text of T2M-GPT,
and `strict` is ours. Every random choice is made here from a seed, so a repeat is a function of data,
protocol, seed and number.
"""

import dataclasses
from collections.abc import Sequence
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from t2m_jax.data.banks.captions import SHORTER_CHANCE, used_lengths
from t2m_jax.data.folder import Clip
from t2m_jax.data.texts import Caption
from t2m_jax.errors import UserError

BATCH = 32
"""Pairs of a batch in the published codes."""
MIN_BATCH = 4
"""R-precision ranks up to the third place, so fewer pairs would always be found."""
# As in the published codes. Guo et al. demand more than 300 motions; with fewer, the later codes draw 100 pairs.
MULTIMODALITY_PAIRS = 10
DIVERSITY_PAIRS = 300
FEW_DIVERSITY_PAIRS = 100
"""If there are at most 300 motions."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Protocol:
    """The rules of one way to evaluate."""

    name: str
    """Its name in reports."""
    captions: Literal["one", "all"] = "one"
    """Whether each motion is used with one of its captions, drawn, or with each of them."""
    crops: bool = True
    """Whether a third of the motions lose one unit (four frames, usually), and motions start at a drawn frame."""
    keeps_tail: bool = False
    """Whether motions that do not fill a batch are used too."""
    generated_length: Literal["model", "real"] = "model"
    """Whether the model decides how long a generated motion is, or the real motion that it is compared with."""
    clears_past_end: bool = True
    """Whether generated frames after the end are set to zero, or left as the decoder made them. Our decoders mask what
    follows the end, so what they leave differs from what the published decoders leave."""
    multimodality_captions: int | None = None
    """Captions whose variety is measured; None is all of them, 0 leaves that metric out."""
    samples_per_caption: int = 30
    """Motions of a caption among which its variety is measured."""
    disjoint_pairs: bool = False
    """Whether a sample is in one pair at most when variety is measured. In the codes, both members of a pair are drawn
    from all samples, so a sample may be in two pairs, and even form a pair with itself."""
    source_disjoint: bool = False
    """Whether clips are left out if their recording is also in training, as far as the data set's index tells."""
    first_counts: bool = True
    """Whether the first sample of a caption is used in the other metrics, or the last."""
    batch: int = BATCH
    """Pairs among which texts and motions are ranked."""

    def __post_init__(self) -> None:
        if self.batch < MIN_BATCH:
            raise UserError(f"batch: {self.batch} is too small; give {MIN_BATCH} or more")


PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        # The defaults are the rules of T2M-GPT's code.
        Protocol(name="t2m-gpt"),
        # Its text has 20 motions of a caption in ten pairs; its code draws ten pairs among 30.
        Protocol(name="t2m-gpt-paper", samples_per_caption=20, disjoint_pairs=True),
        # Guo et al. draw 100 captions for the variety, where T2M-GPT takes all.
        Protocol(name="text-to-motion", multimodality_captions=100),
        # Of one batch, so that two CPU cores are enough for the benchmark.
        Protocol(name="benchmark", multimodality_captions=BATCH),
        Protocol(
            # MoMask's generator is told the real length, and its evaluation leaves what the decoder makes past the end.
            name="momask",
            generated_length="real",
            clears_past_end=False,
            # Its first three batches; the other metrics use the last of their samples.
            multimodality_captions=3 * BATCH,
            first_counts=False,
        ),
        # Nothing is drawn and nothing is dropped, so only the model can change a figure.
        Protocol(name="strict", captions="all", crops=False, keeps_tail=True, source_disjoint=True),
    )
}


def find_protocol(name: str) -> Protocol:
    """Returns a protocol by name.

    Raises:
        UserError: There is none of that name.
    """
    if name not in PROTOCOLS:
        raise UserError(f"protocol: {name!r} is unknown; known: {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]


class Plan(NamedTuple):
    """One repeat: N motions, each a piece of a sample with one caption, batch by batch."""

    samples: Int[np.ndarray, " N"]
    """Index of each motion among the samples."""
    captions: Int[np.ndarray, " N"]
    """Index of each caption among those of the sample."""
    starts: Int[np.ndarray, " N"]
    """First frame."""
    lengths: Int[np.ndarray, " N"]
    """Frames, a multiple of the unit."""
    varied: Int[np.ndarray, " M"]
    """Indices of the items whose captions are used to measure variety."""
    diversity_pairs: Int[np.ndarray, "P 2"]
    """Pairs of items for diversity."""
    multimodality_pairs: Int[np.ndarray, "Q 2"]
    """Pairs of samples of one caption for multimodality, the same for every caption."""

    def pieces(self, samples: Sequence[Clip], *, max_frames: int | None = None) -> list[Float[np.ndarray, "_ D"]]:
        """Returns the raw features of each motion, cut to `max_frames`."""
        ends = self.starts + np.minimum(self.lengths, max_frames or self.lengths)
        spans = zip(self.samples, self.starts, ends, strict=True)
        return [samples[owner].features[start:end] for owner, start, end in spans]

    def chosen_captions(self, samples: Sequence[Clip]) -> list[Caption]:
        """Returns the caption of each motion."""
        pairs = zip(self.samples, self.captions, strict=True)
        return [samples[owner].captions[caption] for owner, caption in pairs]


def make_plan(samples: Sequence[Clip], protocol: Protocol, *, seed: int, repeat: int, unit: int) -> Plan:
    """Returns what a repeat uses.

    Args:
        samples: Motions of the split, whole or parts, each with captions that describe all of it.
        protocol: The rules.
        seed: Start of every random choice.
        repeat: Number of the repeat.
        unit: Lengths are multiples of this many frames.

    Raises:
        UserError: There are fewer motions than one batch.
    """
    # The order of the draws is part of a protocol: another order would give other figures for the same seed.
    generator = np.random.default_rng([seed, repeat])
    batch = protocol.batch
    order = generator.permutation(len(samples))
    num_captions = np.array([len(sample.captions) for sample in samples])
    if protocol.captions == "one":
        owners = order
        captions = generator.integers(0, num_captions[order])
    else:  # in rounds, first every motion with its first caption, so that few batches contain a motion twice
        rounds = range(max(num_captions, default=0))
        items = [(owner, caption) for caption in rounds for owner in order if caption < num_captions[owner]]
        owners, captions = np.array(items).reshape(-1, 2).T
    count = len(owners) if protocol.keeps_tail else len(owners) // batch * batch
    if count < batch:
        found = f"{len(owners)} motions with captions do not fill a batch of {batch}"
        smaller = f", or a smaller batch (`t2m evaluate ... --batch {len(owners)}`)" if len(owners) >= MIN_BATCH else ""
        raise UserError(f"protocol {protocol.name}: {found}; use another split{smaller}")
    # The published loaders drop the last batch if it is not full.
    owners = owners[:count]
    frames = np.array([len(samples[owner].features) for owner in owners])
    # The published loaders toss this coin for each clip, so real lengths differ from one pass to the next.
    shorter = generator.random(count) < SHORTER_CHANCE if protocol.crops else np.zeros(count, bool)
    lengths = np.asarray(used_lengths(jnp.asarray(frames), jnp.asarray(shorter), unit=unit))
    starts = generator.integers(0, frames - lengths + 1) if protocol.crops else np.zeros(count, np.int64)
    wanted = protocol.multimodality_captions
    varied = count if wanted is None else min(wanted, count)
    # The published codes demand more motions than pairs.
    pairs = DIVERSITY_PAIRS if count > DIVERSITY_PAIRS else min(FEW_DIVERSITY_PAIRS, count - 1)
    return Plan(
        owners,
        captions[:count],
        starts,
        lengths,
        np.sort(generator.choice(count, varied, replace=False)),
        _draw_pairs(generator, count, pairs),
        _draw_pairs(generator, protocol.samples_per_caption, MULTIMODALITY_PAIRS, disjoint=protocol.disjoint_pairs),
    )


def _draw_pairs(
    generator: np.random.Generator, count: int, number: int, *, disjoint: bool = False
) -> Int[np.ndarray, "P 2"]:
    """Returns pairs of `count` things: all different, or the two members of two draws without replacement."""
    if disjoint:
        return generator.choice(count, (number, 2), replace=False)
    # The draws are independent, so a thing may be paired with itself, as in the published codes.
    return np.stack([generator.choice(count, number, replace=False) for _ in range(2)], axis=1)
