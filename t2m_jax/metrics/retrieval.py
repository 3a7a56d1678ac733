"""How well texts and motions find each other, by Euclidean distance of their embeddings (Guo et al. 2022).

Pairs come in batches of 32: each item is ranked among the 32 candidates of its batch, and batches are pooled.
"""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

Direction = Literal["motions_per_text", "texts_per_motion"]


class Standing(NamedTuple):
    """How each query's own candidate stands among those of other labels."""

    nearer: Int[Array, " B"]
    """Candidates nearer than its own."""
    tied: Int[Array, " B"]
    """Others exactly as near."""


def own_standing(queries: Float[Array, "B E"], candidates: Float[Array, "B E"], labels: Int[Array, " B"]) -> Standing:
    """Returns how many candidates of another label are nearer to each query than its own, and how many as near."""
    differences = queries[:, None, :] - candidates[None, :, :]
    distances = jnp.sqrt(jnp.sum(differences**2, axis=-1))
    own, others = jnp.diagonal(distances)[:, None], labels[:, None] != labels[None, :]
    return Standing(jnp.sum((distances < own) & others, axis=1), jnp.sum((distances == own) & others, axis=1))


def _hit_chances(standing: Standing, top_k: int) -> Float[Array, "B K"]:
    """Returns the chance that each own candidate is among the 1, 2, ... nearest if chance orders what is as near."""
    places = jnp.arange(1, top_k + 1)[None, :] - standing.nearer[:, None]
    return jnp.clip(places / (standing.tied[:, None] + 1), 0.0, 1.0)


def _mean_hits(standing: Standing, top_k: int, counted: Bool[Array, " N"] | None) -> Float[Array, " K"]:
    """Returns the mean of the hits over what counts."""
    weights = jnp.ones(len(standing.nearer)) if counted is None else counted.astype(jnp.float32)
    return jnp.sum(_hit_chances(standing, top_k) * weights[:, None], axis=0) / jnp.sum(weights)


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
    """Returns the share of items whose partner is among the 1, 2, ... `top_k` nearest of its batch.

    Candidates exactly as near as the partner, such as equal captions, share its place: a model that makes one motion
    for all texts is at chance. (The published codes leave their order to the sort.)

    Args:
        text: Embeddings of captions.
        motion: Embeddings of motions, row by row their partners.
        top_k: Largest k.
        batch: Candidates each item is ranked among; consecutive rows. Chance is k / batch.
        direction: `motions_per_text` ranks motions for each text, as the published codes do; `texts_per_motion` is what
            their papers describe.
        labels: What an item shows. Candidates of the same label are not counted as errors; without, each pair is its
            own label.
        counted: Pairs whose rank counts, by default all; the others are candidates alone, as where a set is filled up
            to whole batches.

    Raises:
        ValueError: if the number of pairs is no multiple of `batch`.
    """
    if len(text) % batch or len(text) != len(motion) or not len(text):
        raise ValueError(f"{len(text)} texts and {len(motion)} motions do not make batches of {batch} pairs")
    queries, candidates = (text, motion) if direction == "motions_per_text" else (motion, text)
    owners = jnp.arange(len(text)) if labels is None else labels
    batches = tuple(rows.reshape(-1, batch, *rows.shape[1:]) for rows in (queries, candidates, owners))
    standing = jax.lax.map(lambda arguments: own_standing(*arguments), batches)
    return _mean_hits(Standing(*(column.reshape(-1) for column in standing)), top_k, counted)


def label_bound(
    labels: Int[Array, " N"], *, top_k: int = 3, batch: int = 32, counted: Bool[Array, " N"] | None = None
) -> Float[Array, " K"]:
    """Returns the R-precision to expect where labels are found without fail and items of one label look all alike.

    With m others of its label in its batch, an item is among the k nearest with a chance of k / (m + 1). What
    `r_precision` finds above it was told apart within labels.

    Raises:
        ValueError: if the number of items is no multiple of `batch`.
    """
    if len(labels) % batch or not len(labels):
        raise ValueError(f"{len(labels)} labels do not make batches of {batch}")
    batches = labels.reshape(-1, batch)
    alike = jnp.sum(batches[:, :, None] == batches[:, None, :], axis=-1).reshape(-1)
    return _mean_hits(Standing(jnp.zeros_like(alike), alike - 1), top_k, counted)


def matching_score(text: Float[Array, "N E"], motion: Float[Array, "N E"]) -> Float[Array, ""]:
    """Returns the mean distance of the pairs (MM-Dist)."""
    return jnp.mean(jnp.sqrt(jnp.sum((text - motion) ** 2, axis=-1)))
