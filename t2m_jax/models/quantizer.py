"""Vector quantization: nearest-code lookup and the codebook's own learning rule (EMA with reset).

The rule is T2M-GPT's (arXiv 2301.06052, section 3.1) as its code has it: sums and counts are averaged separately, a
code whose averaged count falls under the threshold is replaced by a row of the current batch, its statistics stay.
"""

from typing import NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

CANDIDATE_NOISE = 0.01
"""Standard deviation of the noise on repeated rows, times 1/sqrt(code_dim)."""


class CodebookState(NamedTuple):
    """What the codebook remembers between steps; the collection `codebook`, leaf for leaf."""

    codebook: Float[Array, "K C"]
    ema_sum: Float[Array, "K C"]
    ema_count: Float[Array, " K"]
    initialised: Bool[Array, ""]


class QuantizerOutput(NamedTuple):
    """One pass through the codebook."""

    quantized: Float[Array, "B N C"]
    """Straight-through: the value of the code, the gradient of the latent."""
    codes: Int[Array, "B N"]
    commitment_loss: Float[Array, ""]
    code_counts: Float[Array, " K"]
    """How often each code was chosen in this batch, masked positions not counted."""


def nearest_codes(latents: Float[Array, "M C"], codebook: Float[Array, "K C"]) -> Int[Array, " M"]:
    """Returns the index of the nearest code by squared distance; ties go to the lowest index."""
    distances = jnp.sum(codebook**2, axis=1)[None, :] - 2.0 * latents @ codebook.T
    return jnp.argmin(distances, axis=1)


def perplexity_from_counts(code_counts: Float[Array, " K"]) -> Float[Array, ""]:
    """Returns exp of the entropy of code use, between 1 and K."""
    share = code_counts / jnp.maximum(jnp.sum(code_counts), 1.0)
    return jnp.exp(-jnp.sum(share * jnp.log(share + 1e-7)))


def candidate_codes(
    latents: Float[Array, "M C"], mask: Bool[Array, " M"], key: PRNGKeyArray, *, num_codes: int
) -> Float[Array, "K C"]:
    """Returns `num_codes` rows to start codes from: the first True rows of the batch, in order.

    With fewer rows than codes the rows are repeated and all of them get a little noise, so that no two codes agree.
    `key` is consumed.
    """
    order = jnp.argsort(~mask, stable=True)
    num_rows = jnp.sum(mask)
    rows = latents[order[jnp.arange(num_codes) % jnp.maximum(num_rows, 1)]]
    noise = CANDIDATE_NOISE * latents.shape[1] ** -0.5 * jax.random.normal(key, rows.shape)
    return rows + jnp.where(num_rows < num_codes, noise, 0.0)


def initial_codebook(state: CodebookState, candidates: Float[Array, "K C"]) -> CodebookState:
    """Returns `state`, or, where it was never initialised, one that starts from `candidates`."""
    fresh = CodebookState(candidates, candidates, jnp.ones_like(state.ema_count), jnp.array(True))
    return jax.tree.map(lambda old, new: jnp.where(state.initialised, old, new), state, fresh)


def hits(
    latents: Float[Array, "M C"], codes: Int[Array, " M"], mask: Bool[Array, " M"], *, num_codes: int
) -> tuple[Float[Array, "K C"], Float[Array, " K"]]:
    """Returns the sum of the latents and their number for each code, over the True rows."""
    weights = mask.astype(latents.dtype)
    sums = jax.ops.segment_sum(latents * weights[:, None], codes, num_segments=num_codes)
    return sums, jax.ops.segment_sum(weights, codes, num_segments=num_codes)


def update_codebook(
    state: CodebookState,
    batch_hits: tuple[Float[Array, "K C"], Float[Array, " K"]],
    candidates: Float[Array, "K C"],
    *,
    decay: float,
    threshold: float,
) -> CodebookState:
    """Returns the codebook after one step of EMA with reset.

    Args:
        state: The codebook that was used for the lookup.
        batch_hits: Sums and counts of `hits`.
        candidates: Row k replaces code k if that code is dead.
        decay: Share of the old averages that is kept.
        threshold: A code lives while its averaged count is at least this.
    """
    sums, counts = batch_hits
    ema_sum = decay * state.ema_sum + (1.0 - decay) * sums
    ema_count = decay * state.ema_count + (1.0 - decay) * counts
    alive = ema_count >= threshold
    # The denominator of a dead code may be 0 or denormal; it must not reach the division even where it is not used.
    averages = ema_sum / jnp.where(alive, ema_count, 1.0)[:, None]
    codebook = jnp.where(alive[:, None], averages, candidates)
    return CodebookState(codebook, ema_sum, ema_count, state.initialised)


class Quantizer(nn.Module):
    """Replaces latents by their nearest codes and, in training, moves the codebook towards them.

    Collection `codebook`: `codebook` [K, C], `ema_sum` [K, C], `ema_count` [K], `initialised` []; it changes only when
    `train` is True and the collection is mutable. RNG stream `codebook` (training): noise on repeated candidates.
    """

    num_codes: int
    code_dim: int
    ema_decay: float
    reset_threshold: float

    def setup(self) -> None:
        """Declares the codebook's variables."""
        rows, counts = (self.num_codes, self.code_dim), (self.num_codes,)
        self.codebook = self.variable("codebook", "codebook", jnp.zeros, rows)
        self.ema_sum = self.variable("codebook", "ema_sum", jnp.zeros, rows)
        self.ema_count = self.variable("codebook", "ema_count", jnp.zeros, counts)
        self.initialised = self.variable("codebook", "initialised", lambda: jnp.array(False))

    def _current(self) -> CodebookState:
        return CodebookState(self.codebook.value, self.ema_sum.value, self.ema_count.value, self.initialised.value)

    def _assign(self, state: CodebookState) -> None:
        self.codebook.value, self.ema_sum.value, self.ema_count.value, self.initialised.value = state

    def __call__(self, latents: Float[Array, "B N C"], mask: Bool[Array, "B N"], *, train: bool) -> QuantizerOutput:
        """Returns quantized latents, codes and the commitment loss, which is taken before the codebook moves."""
        rows = latents.reshape(-1, self.code_dim)
        row_mask = mask.reshape(-1)
        state = self._current()
        learn = train and self.is_mutable_collection("codebook") and not self.is_initializing()
        if learn:
            initial_key, reset_key = jax.random.split(self.make_rng("codebook"))
            detached = jax.lax.stop_gradient(rows)
            first = candidate_codes(detached, row_mask, initial_key, num_codes=self.num_codes)
            state = initial_codebook(state, first)
        codes = nearest_codes(rows, state.codebook)
        batch_hits = hits(jax.lax.stop_gradient(rows), codes, row_mask, num_codes=self.num_codes)
        quantized = state.codebook[codes]
        squared = jnp.where(row_mask[:, None], (rows - jax.lax.stop_gradient(quantized)) ** 2, 0.0)
        loss = jnp.sum(squared) / jnp.maximum(jnp.sum(row_mask) * self.code_dim, 1)
        if learn:
            candidates = candidate_codes(detached, row_mask, reset_key, num_codes=self.num_codes)
            self._assign(
                update_codebook(state, batch_hits, candidates, decay=self.ema_decay, threshold=self.reset_threshold)
            )
        straight_through = rows + jax.lax.stop_gradient(quantized - rows)
        return QuantizerOutput(straight_through.reshape(latents.shape), codes.reshape(mask.shape), loss, batch_hits[1])

    def lookup(self, codes: Int[Array, "B N"]) -> Float[Array, "B N C"]:
        """Returns the codebook rows of `codes`."""
        return self.codebook.value[codes]
