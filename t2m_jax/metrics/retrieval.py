"""How well texts and motions find each other, by Euclidean distance of their embeddings (Guo et al. 2022).

Pairs come in batches of 32: each item is ranked among the 32 candidates of its batch, and batches are pooled.
"""

from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

Direction = Literal["motions_per_text", "texts_per_motion"]


def own_ranks(
    queries: Float[Array, "B E"], candidates: Float[Array, "B E"], labels: Int[Array, " B"]
) -> Int[Array, " B"]:
    """Returns how many candidates of another label are nearer to each query than its own."""
    differences = queries[:, None, :] - candidates[None, :, :]
    distances = jnp.sqrt(jnp.sum(differences**2, axis=-1))
    nearer = distances < jnp.diagonal(distances)[:, None]
    return jnp.sum(nearer & (labels[:, None] != labels[None, :]), axis=1)


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
    ranks = jax.lax.map(lambda arguments: own_ranks(*arguments), batches).reshape(-1)
    weights = jnp.ones(len(ranks)) if counted is None else counted.astype(jnp.float32)
    hits = ranks[:, None] < jnp.arange(1, top_k + 1)[None, :]
    return jnp.sum(hits * weights[:, None], axis=0) / jnp.sum(weights)


def matching_score(text: Float[Array, "N E"], motion: Float[Array, "N E"]) -> Float[Array, ""]:
    """Returns the mean distance of the pairs (MM-Dist)."""
    return jnp.mean(jnp.sqrt(jnp.sum((text - motion) ** 2, axis=-1)))
