"""How a codebook learns: the state that it keeps, and the rules by which it moves.

Four rules are those of T2M-GPT (arXiv 2301.06052, section 3.1 and table 3), as implemented in its code. `orig` trains
the codebook by gradient. The others move it directly. `ema` and `ema_reset` move each code to the running average of
the vectors that chose it; sums and counts are averaged separately. `reset` and `ema_reset` replace a code that is
rarely chosen by a vector of the current batch and keep its statistics. With `reset` alone, replacement is the only
change. `ema_redraw` is the rule of T2M-HiFiGPT, as decided in `docs/hifigpt.md`: a code that is rarely chosen is
replaced by a random vector of the current batch, and its statistics start again.

With residual quantization, a vector is a latent or one of its residuals. All depths share the codebook.
"""

import dataclasses
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from t2m_jax.devices import global_rows, global_sum

CANDIDATE_NOISE = 0.01
"""Standard deviation of the noise on repeated rows, before division by sqrt(code_dim)."""
LEAST_COUNT = 1e-30
"""Smallest averaged count of a code that is averaged. Smaller counts remain of codes that were not used for thousands
of steps, and dividing by them gives no useful code."""

QuantizerKind = Literal["orig", "ema", "reset", "ema_reset", "ema_redraw"]


@dataclasses.dataclass(frozen=True)
class CodebookRule:
    """How a codebook moves in training. If it neither averages nor resets, it is a parameter and learns by gradient."""

    averages: bool
    """Codes follow the running average of the vectors that chose them."""
    resets: bool
    """Codes that are rarely chosen are replaced by vectors of the batch."""
    redraws: bool = False
    """The replacements are drawn from all vectors, and the statistics of a replaced code start again."""

    @property
    def by_gradient(self) -> bool:
        """Whether the optimizer moves the codebook."""
        return not (self.averages or self.resets)


RULES: dict[str, CodebookRule] = {
    "orig": CodebookRule(averages=False, resets=False),
    "ema": CodebookRule(averages=True, resets=False),
    "reset": CodebookRule(averages=False, resets=True),
    "ema_reset": CodebookRule(averages=True, resets=True),
    "ema_redraw": CodebookRule(averages=True, resets=True, redraws=True),
}


class CodebookState(NamedTuple):
    """The collection `codebook`: what a codebook that is not trained by gradient keeps between steps.

    Without averaging, `ema_sum` and `ema_count` are the values of the last batch.
    """

    codebook: Float[Array, "K C"]
    ema_sum: Float[Array, "K C"]
    ema_count: Float[Array, " K"]
    initialised: Bool[Array, ""]


class Pool(NamedTuple):
    """The vectors of the global batch from which new codes are drawn, depth after depth."""

    vectors: Float[Array, "P C"]
    usable: Bool[Array, " P"]
    """Whether a vector is not zero and not past the end of a motion."""


def candidate_codes(
    latents: Float[Array, "M C"], mask: Bool[Array, " M"], noise: Float[Array, "K C"]
) -> Float[Array, "K C"]:
    """Returns K rows that codes can start from: the first True rows of the global batch, in order.

    If there are fewer rows than codes, rows are repeated, and `noise` (standard normal) is scaled and added to all of
    them, so that no two codes are equal.
    """
    num_codes = noise.shape[0]
    latents, mask = global_rows((latents, mask))
    # A stable sort of False before True brings the data rows to the front without a shape that depends on the data.
    order = jnp.argsort(~mask, stable=True)
    num_rows = jnp.sum(mask)
    rows = latents[order[jnp.arange(num_codes) % jnp.maximum(num_rows, 1)]]
    # As in the original, which adds the noise to all rows once some are repeated.
    scale = CANDIDATE_NOISE * latents.shape[1] ** -0.5
    return rows + jnp.where(num_rows < num_codes, scale * noise, 0.0)


def initial_codebook(state: CodebookState, candidates: Float[Array, "K C"]) -> CodebookState:
    """Returns `state` if it was initialized, else a state that starts from `candidates`."""
    fresh = CodebookState(candidates, candidates, jnp.ones_like(state.ema_count), jnp.array(True))
    return jax.tree.map(lambda old, new: jnp.where(state.initialised, old, new), state, fresh)


def count_codes(codes: Int[Array, "R M"], mask: Bool[Array, "R M"], *, num_codes: int) -> Float[Array, "R K"]:
    """Returns how often each code was chosen at each depth, where the mask is True, on all devices."""

    def count(row: Int[Array, " M"], counted: Bool[Array, " M"]) -> Float[Array, " K"]:
        return jax.ops.segment_sum(counted.astype(jnp.float32), row, num_segments=num_codes)

    return global_sum(jax.vmap(count)(codes, mask))


def hits(
    vectors: Float[Array, "R M C"], codes: Int[Array, "R M"], mask: Bool[Array, "R M"], *, num_codes: int
) -> tuple[Float[Array, "K C"], Float[Array, " K"]]:
    """Returns the sum of the vectors that chose each code, and their number: all depths, where the mask is True."""
    counted = jnp.where(mask[:, :, None], vectors, 0.0).reshape(-1, vectors.shape[-1])
    sums = jax.ops.segment_sum(counted, codes.reshape(-1), num_segments=num_codes)
    return global_sum(sums), jnp.sum(count_codes(codes, mask, num_codes=num_codes), axis=0)


def update_codebook(
    state: CodebookState,
    batch_hits: tuple[Float[Array, "K C"], Float[Array, " K"]],
    candidates: Float[Array, "K C"] | None,
    *,
    rule: CodebookRule,
    decay: float,
    threshold: float,
) -> CodebookState:
    """Returns the codebook after one step of a rule that averages, resets, or does both.

    Args:
        state: The codebook that was used for the lookup.
        batch_hits: Sums and counts.
        candidates: Row k replaces code k if that code is dead; None if the rule does not reset, or draws.
        rule: Whether to average and whether to reset.
        decay: Share of the old averages that a step keeps.
        threshold: A code is dead if its count (averaged, if the rule averages) is below this.
    """
    kept = decay if rule.averages else 0.0
    ema_sum, ema_count = (
        kept * old + (1.0 - kept) * new for old, new in zip((state.ema_sum, state.ema_count), batch_hits, strict=True)
    )
    alive = ema_count >= (LEAST_COUNT if candidates is None else threshold)
    codebook = state.codebook
    if rule.averages:
        # The count of a dead code may be 0 or denormal. Dividing by it would give NaN, also in the unused branch.
        codebook = jnp.where(alive[:, None], ema_sum / jnp.where(alive, ema_count, 1.0)[:, None], codebook)
    if candidates is not None:
        codebook = jnp.where(alive[:, None], codebook, candidates)
    return CodebookState(codebook, ema_sum, ema_count, state.initialised)


def make_pool(vectors: Float[Array, "R M C"], mask: Bool[Array, "R M"]) -> Pool:
    """Returns the vectors of all depths and all devices; `mask` is True where they may be used."""
    # Rows first, because devices have different rows.
    rows, allowed = global_rows((jnp.swapaxes(vectors, 0, 1), mask.T))
    rows = jnp.swapaxes(rows, 0, 1)
    allowed = allowed.T
    return Pool(rows.reshape(-1, rows.shape[-1]), (allowed & jnp.any(rows != 0, axis=-1)).reshape(-1))


def draw_from_pool(pool: Pool, count: int, key: Key[Array, ""]) -> Int[Array, " {count}"]:
    """Returns the numbers of `count` usable vectors, drawn without replacement; repeated if there are fewer."""
    # The largest of random ranks: a draw without replacement whose shape does not depend on the data.
    ranks = jnp.where(pool.usable, jax.random.uniform(key, pool.usable.shape), -1.0)
    order = jax.lax.top_k(ranks, min(count, len(ranks)))[1]
    number = jnp.clip(jnp.sum(pool.usable), 1, len(order))
    return order[jnp.arange(count) % number]


def draw_codes(pool: Pool, fallback: Float[Array, "K C"], key: Key[Array, ""]) -> Float[Array, "K C"]:
    """Returns K vectors drawn from the pool, or `fallback` if none of them is usable."""
    return jnp.where(jnp.any(pool.usable), pool.vectors[draw_from_pool(pool, len(fallback), key)], fallback)


def redraw_dead(
    state: CodebookState, pool: Pool, key: Key[Array, ""], *, threshold: float, depth: int
) -> tuple[CodebookState, Float[Array, " {depth}"]]:
    """Returns the state with dead codes replaced by vectors of the pool, and how many came from each depth.

    A code is dead if its averaged count is below the threshold. The count of a new code is 1.
    """
    drawn = draw_from_pool(pool, len(state.ema_count), key)
    dead = (state.ema_count < threshold) & jnp.any(pool.usable)
    # The dead codes take the first of the drawn vectors, so that none comes twice if there are enough.
    source = drawn[jnp.maximum(jnp.cumsum(dead) - 1, 0)]
    new = pool.vectors[source]
    codebook, ema_sum = (jnp.where(dead[:, None], new, old) for old in (state.codebook, state.ema_sum))
    replaced = CodebookState(codebook, ema_sum, jnp.where(dead, 1.0, state.ema_count), state.initialised)
    depths = source // (len(pool.usable) // depth)
    return replaced, jax.ops.segment_sum(dead.astype(jnp.float32), depths, num_segments=depth)
