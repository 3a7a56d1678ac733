"""Retrieval of motions by text and of texts by motion, by Euclidean distance of embeddings (Guo et al. 2022).

Each item is ranked among the 32 candidates of its batch. The results of all batches are averaged.
"""

from typing import Literal, NamedTuple

import chex
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

Direction = Literal["motions_per_text", "texts_per_motion"]


class PartnerRanks(NamedTuple):
    """The rank of each query's partner among the candidates with other labels."""

    nearer: Int[Array, "*M B"]
    """Number of candidates that are nearer than the partner."""
    tied: Int[Array, "*M B"]
    """Number of other candidates at exactly the same distance."""


@jax.jit
def ranks_of_batches(
    queries: Float[Array, "M B E"], candidates: Float[Array, "M B E"], labels: Int[Array, "M B"]
) -> PartnerRanks:
    """Returns the ranks [M, B] of the candidates that belong to the queries. Equal labels are not compared."""

    def ranks(batch: tuple[Float[Array, "B E"], Float[Array, "B E"], Int[Array, " B"]]) -> PartnerRanks:
        queries, candidates, labels = batch
        differences = queries[:, None, :] - candidates[None, :, :]
        # The dot product of the published codes would be rounded: equal distances would differ, small squares be
        # negative.
        distances = jnp.sqrt(jnp.sum(differences**2, axis=-1))
        # No comparison with NaN holds, so what is broken would be nearer than all.
        distances = jnp.where(jnp.isnan(distances), jnp.inf, distances)
        own = jnp.diagonal(distances)[:, None]
        others = labels[:, None] != labels[None, :]
        nearer = jnp.sum((distances < own) & others, axis=1)
        # What is broken is tied with all that is broken, but no partner by chance.
        nearer = jnp.where(jnp.isfinite(own[:, 0]), nearer, len(own))
        return PartnerRanks(nearer, jnp.sum((distances == own) & others, axis=1))

    # One batch after another, because all differences at once would be 32 times as large as the embeddings.
    return jax.lax.map(ranks, (queries, candidates, labels))


def _mean_hits(ranks: PartnerRanks, top_k: int, counted: Bool[Array, " N"] | None) -> Float[Array, " K"]:
    """Returns the mean chance that a partner is among the 1, 2, ... nearest if ties are ordered at random."""
    # A tie at the boundary is inside with the chance that a random order gives: places left / candidates tied.
    places = jnp.arange(1, top_k + 1)[None, :] - ranks.nearer[:, None]
    chances = jnp.clip(places / (ranks.tied[:, None] + 1), 0.0, 1.0)
    weights = jnp.ones(len(ranks.nearer)) if counted is None else counted.astype(jnp.float32)
    return jnp.sum(chances * weights[:, None], axis=0) / jnp.sum(weights)


def r_precision(
    text: Float[Array, "N E"],
    motion: Float[Array, "N E"],
    *,
    top_k: int = 3,
    batch: int = 32,
    direction: Direction = "motions_per_text",
    labels: Int[Array, " N"] | None = None,
    counted: Bool[Array, " N"] | None = None,
) -> Float[Array, " K"]:
    """Returns the share of items whose partner is among the 1, 2, ... `top_k` nearest candidates of its batch.

    Candidates at exactly the same distance, such as equal captions, share their ranks, so that a model that generates
    one motion for all texts is at chance. (In the published code, their order depends on the sort.)

    Args:
        text: Embeddings of captions.
        motion: Embeddings of motions. Those with the same index are partners.
        top_k: Largest k.
        batch: Number of candidates, which are consecutive. Chance is k / batch.
        direction: `motions_per_text` ranks motions for each text, as the published code does. `texts_per_motion` is
            what the papers describe.
        labels: The class of each item. Candidates of the same class are not errors. By default each pair is a class.
        counted: True for pairs whose rank counts, by default all. The others are only candidates, such as pairs that
            fill the last batch.

    Raises:
        ValueError: The number of pairs is not a multiple of `batch`.
    """
    chex.assert_rank([text, motion], 2)
    chex.assert_equal_shape([text, motion])
    chex.assert_shape([given for given in (labels, counted) if given is not None], (len(text),))
    chex.assert_scalar_in(top_k, 1, batch)
    if len(text) % batch or not len(text):
        raise ValueError(f"{len(text)} texts and {len(motion)} motions do not make batches of {batch} pairs")
    queries, candidates = (text, motion) if direction == "motions_per_text" else (motion, text)
    owners = jnp.arange(len(text)) if labels is None else labels
    batches = tuple(items.reshape(-1, batch, *items.shape[1:]) for items in (queries, candidates, owners))
    ranks = ranks_of_batches(*batches)
    return _mean_hits(PartnerRanks(*(column.reshape(-1) for column in ranks)), top_k, counted)


def label_bound(
    labels: Int[Array, " N"], *, top_k: int = 3, batch: int = 32, counted: Bool[Array, " N"] | None = None
) -> Float[Array, " K"]:
    """Returns the expected R-precision of a perfect classifier that cannot distinguish items of one label.

    If m other items of the batch have its label, an item is among the k nearest with a probability of k / (m + 1). An
    `r_precision` above this bound shows that items of one label are distinguished.

    Raises:
        ValueError: The number of items is not a multiple of `batch`.
    """
    chex.assert_shape([labels] if counted is None else [labels, counted], (len(labels),))
    chex.assert_scalar_in(top_k, 1, batch)
    if len(labels) % batch or not len(labels):
        raise ValueError(f"{len(labels)} labels do not make batches of {batch}")
    batches = labels.reshape(-1, batch)
    alike = jnp.sum(batches[:, :, None] == batches[:, None, :], axis=-1).reshape(-1)
    # For this classifier, all items of a label are at the same distance.
    return _mean_hits(PartnerRanks(jnp.zeros_like(alike), alike - 1), top_k, counted)


def matching_score(text: Float[Array, "N E"], motion: Float[Array, "N E"]) -> Float[Array, ""]:
    """Returns the mean distance of each text from its motion (MM-Dist)."""
    chex.assert_rank([text, motion], 2)
    chex.assert_equal_shape([text, motion])
    return jnp.mean(jnp.sqrt(jnp.sum((text - motion) ** 2, axis=-1)))
