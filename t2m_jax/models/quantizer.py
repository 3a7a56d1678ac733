"""Vector quantization: nearest-code lookup, and four ways in which a codebook learns.

They are those of T2M-GPT (arXiv 2301.06052, section 3.1 and table 3) as its code has them. `orig` trains the codebook
by gradient; the others move it themselves: `ema` and `ema_reset` to the running average of the latents that chose a
code, with sums and counts averaged separately; `reset` and `ema_reset` replace a code that is hardly chosen by a row of
the current batch, and leave its statistics alone. With `reset` alone a code never moves but by being replaced.
"""

import dataclasses
from typing import Literal, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

CANDIDATE_NOISE = 0.01
"""Standard deviation of the noise on repeated rows, times 1/sqrt(code_dim)."""
LEAST_COUNT = 1e-30
"""Averaged counts below this are leftovers of codes unused for thousands of steps: their average means nothing."""

QuantizerKind = Literal["orig", "ema", "reset", "ema_reset"]


@dataclasses.dataclass(frozen=True)
class CodebookRule:
    """How a codebook moves in training; one that does neither is a parameter and learns by gradient."""

    averages: bool
    """Codes follow the running average of the latents that chose them."""
    resets: bool
    """Codes that are hardly chosen are replaced by latents of the batch."""

    @property
    def by_gradient(self) -> bool:
        """Whether the optimiser moves the codebook."""
        return not (self.averages or self.resets)


RULES: dict[str, CodebookRule] = {
    "orig": CodebookRule(averages=False, resets=False),
    "ema": CodebookRule(averages=True, resets=False),
    "reset": CodebookRule(averages=False, resets=True),
    "ema_reset": CodebookRule(averages=True, resets=True),
}


class CodebookState(NamedTuple):
    """What a codebook that moves itself remembers between steps; the collection `codebook`, leaf for leaf.

    Without averaging, `ema_sum` and `ema_count` are those of the last batch alone.
    """

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
    """Mean squared distance of latents and codes; for a codebook that learns by gradient its own loss is added, which
    is equal in value and pulls the codes."""
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
    rule: CodebookRule,
    decay: float,
    threshold: float,
) -> CodebookState:
    """Returns the codebook after one step of a rule that averages, resets, or does both.

    Args:
        state: The codebook that was used for the lookup.
        batch_hits: Sums and counts of `hits`.
        candidates: Row k replaces code k if that code is dead.
        rule: What to do.
        decay: Share of the old averages that is kept.
        threshold: A code lives while its count, averaged if the rule averages, is at least this.
    """
    kept = decay if rule.averages else 0.0
    ema_sum, ema_count = (
        kept * old + (1.0 - kept) * new for old, new in zip((state.ema_sum, state.ema_count), batch_hits, strict=True)
    )
    alive = ema_count >= (threshold if rule.resets else LEAST_COUNT)
    codebook = state.codebook
    if rule.averages:
        # The denominator of a dead code may be 0 or denormal; it must not reach the division even where it is unused.
        codebook = jnp.where(alive[:, None], ema_sum / jnp.where(alive, ema_count, 1.0)[:, None], codebook)
    if rule.resets:
        codebook = jnp.where(alive[:, None], codebook, candidates)
    return CodebookState(codebook, ema_sum, ema_count, state.initialised)


class Quantizer(nn.Module):
    """Replaces latents by their nearest codes and, in training, moves the codebook towards them.

    Of kind `orig` the codebook is the parameter `codebook` [K, C]. Otherwise it is the collection `codebook`:
    `codebook` [K, C], `ema_sum` [K, C], `ema_count` [K], `initialised` []; it changes only when `train` is True and the
    collection is mutable. RNG stream `codebook` (training): noise on repeated candidates.
    """

    num_codes: int
    code_dim: int
    kind: QuantizerKind
    ema_decay: float
    reset_threshold: float

    def setup(self) -> None:
        """Declares the codebook."""
        rows, counts = (self.num_codes, self.code_dim), (self.num_codes,)
        if RULES[self.kind].by_gradient:
            self.embedding = self.param("codebook", _uniform_codes, rows)
            return
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
        rows, row_mask = latents.reshape(-1, self.code_dim), mask.reshape(-1)
        rule = RULES[self.kind]
        moves = train and not rule.by_gradient and self.is_mutable_collection("codebook") and not self.is_initializing()
        if moves:
            self._start(rows, row_mask)
        codebook = self._codebook()
        codes = nearest_codes(rows, codebook)
        batch_hits = hits(jax.lax.stop_gradient(rows), codes, row_mask, num_codes=self.num_codes)
        quantized = codebook[codes]
        loss = _mean_square(rows - jax.lax.stop_gradient(quantized), row_mask)
        if rule.by_gradient:
            loss += _mean_square(quantized - jax.lax.stop_gradient(rows), row_mask)
        if moves:
            self._move(rows, row_mask, batch_hits)
        straight_through = rows + jax.lax.stop_gradient(quantized - rows)
        return QuantizerOutput(straight_through.reshape(latents.shape), codes.reshape(mask.shape), loss, batch_hits[1])

    def _candidates(self, rows: Float[Array, "M C"], row_mask: Bool[Array, " M"]) -> Float[Array, "K C"]:
        return candidate_codes(
            jax.lax.stop_gradient(rows), row_mask, self.make_rng("codebook"), num_codes=self.num_codes
        )

    def _start(self, rows: Float[Array, "M C"], row_mask: Bool[Array, " M"]) -> None:
        """Makes a codebook that was never used start from the first batch."""
        self._assign(initial_codebook(self._current(), self._candidates(rows, row_mask)))

    def _move(
        self,
        rows: Float[Array, "M C"],
        row_mask: Bool[Array, " M"],
        batch_hits: tuple[Float[Array, "K C"], Float[Array, " K"]],
    ) -> None:
        """Moves the codebook by one step."""
        state = update_codebook(
            self._current(),
            batch_hits,
            self._candidates(rows, row_mask),
            rule=RULES[self.kind],
            decay=self.ema_decay,
            threshold=self.reset_threshold,
        )
        self._assign(state)

    def _codebook(self) -> Float[Array, "K C"]:
        return self.embedding if RULES[self.kind].by_gradient else self.codebook.value

    def lookup(self, codes: Int[Array, "B N"]) -> Float[Array, "B N C"]:
        """Returns the codebook rows of `codes`."""
        return self._codebook()[codes]


def _uniform_codes(key: PRNGKeyArray, shape: tuple[int, int]) -> Float[Array, "K C"]:
    return jax.random.uniform(key, shape, minval=-1.0 / shape[0], maxval=1.0 / shape[0])


def _mean_square(difference: Float[Array, "M C"], mask: Bool[Array, " M"]) -> Float[Array, ""]:
    """Returns the mean of squares over the True rows."""
    squares = jnp.where(mask[:, None], difference**2, 0.0)
    return jnp.sum(squares) / jnp.maximum(jnp.sum(mask) * difference.shape[1], 1)
