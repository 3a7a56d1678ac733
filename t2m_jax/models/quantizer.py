"""Vector quantization: nearest-code lookup, and four rules by which a codebook learns.

The rules are those of T2M-GPT (arXiv 2301.06052, section 3.1 and table 3), as implemented in its code. `orig` trains
the codebook by gradient. The others move it directly. `ema` and `ema_reset` move each code to the running average of
the latents that chose it; sums and counts are averaged separately. `reset` and `ema_reset` replace a code that is
rarely chosen by a row of the current batch and keep its statistics. With `reset` alone, replacement is the only change.
"""

import dataclasses
from typing import Literal, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.devices import global_rows, global_sum
from t2m_jax.masks import masked_mean
from t2m_jax.models.convolution import uniform_init

CANDIDATE_NOISE = 0.01
"""Standard deviation of the noise on repeated rows, before division by sqrt(code_dim)."""
LEAST_COUNT = 1e-30
"""Smallest averaged count of a code that is averaged. Smaller counts remain of codes that were not used for thousands
of steps, and dividing by them gives no useful code."""

QuantizerKind = Literal["orig", "ema", "reset", "ema_reset"]


@dataclasses.dataclass(frozen=True)
class CodebookRule:
    """How a codebook moves in training. If it neither averages nor resets, it is a parameter and learns by gradient."""

    averages: bool
    """Codes follow the running average of the latents that chose them."""
    resets: bool
    """Codes that are rarely chosen are replaced by latents of the batch."""

    @property
    def by_gradient(self) -> bool:
        """Whether the optimizer moves the codebook."""
        return not (self.averages or self.resets)


RULES: dict[str, CodebookRule] = {
    "orig": CodebookRule(averages=False, resets=False),
    "ema": CodebookRule(averages=True, resets=False),
    "reset": CodebookRule(averages=False, resets=True),
    "ema_reset": CodebookRule(averages=True, resets=True),
}


class CodebookState(NamedTuple):
    """The collection `codebook`: what a codebook that is not trained by gradient keeps between steps.

    Without averaging, `ema_sum` and `ema_count` are the values of the last batch.
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
    """Mean squared distance of latents and codes. If the codebook learns by gradient, its own loss is added: the same
    value, with the gradient to the codes."""
    code_counts: Float[Array, " K"]
    """How often each code was chosen in this batch, masked positions not counted."""


def nearest_codes(latents: Float[Array, "M C"], codebook: Float[Array, "K C"]) -> Int[Array, " M"]:
    """Returns the index of the nearest code by squared distance; ties go to the lowest index."""
    # Full precision on every device: with TF32, one code in a thousand differs.
    products = jnp.matmul(latents, codebook.T, precision=jax.lax.Precision.HIGHEST)
    distances = jnp.sum(codebook**2, axis=1)[None, :] - 2.0 * products
    return jnp.argmin(distances, axis=1)


def candidate_codes(
    latents: Float[Array, "M C"], mask: Bool[Array, " M"], noise: Float[Array, "K C"]
) -> Float[Array, "K C"]:
    """Returns K rows that codes can start from: the first True rows of the global batch, in order.

    If there are fewer rows than codes, rows are repeated, and `noise` (standard normal) is scaled and added to all of
    them, so that no two codes are equal.
    """
    num_codes, (latents, mask) = noise.shape[0], global_rows((latents, mask))
    order = jnp.argsort(~mask, stable=True)
    num_rows = jnp.sum(mask)
    rows = latents[order[jnp.arange(num_codes) % jnp.maximum(num_rows, 1)]]
    scale = CANDIDATE_NOISE * latents.shape[1] ** -0.5
    return rows + jnp.where(num_rows < num_codes, scale * noise, 0.0)


def initial_codebook(state: CodebookState, candidates: Float[Array, "K C"]) -> CodebookState:
    """Returns `state` if it was initialized, else a state that starts from `candidates`."""
    fresh = CodebookState(candidates, candidates, jnp.ones_like(state.ema_count), jnp.array(True))
    return jax.tree.map(lambda old, new: jnp.where(state.initialised, old, new), state, fresh)


def hits(
    latents: Float[Array, "M C"], codes: Int[Array, " M"], mask: Bool[Array, " M"], *, num_codes: int
) -> tuple[Float[Array, "K C"], Float[Array, " K"]]:
    """Returns the sum of the latents and their number for each code, over the True rows of the global batch."""
    weights = mask.astype(latents.dtype)
    sums = jax.ops.segment_sum(latents * weights[:, None], codes, num_segments=num_codes)
    return global_sum((sums, jax.ops.segment_sum(weights, codes, num_segments=num_codes)))


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
        rule: Whether to average and whether to reset.
        decay: Share of the old averages that is kept.
        threshold: A code is dead if its count (averaged, if the rule averages) is below this.
    """
    kept = decay if rule.averages else 0.0
    ema_sum, ema_count = (
        kept * old + (1.0 - kept) * new for old, new in zip((state.ema_sum, state.ema_count), batch_hits, strict=True)
    )
    alive = ema_count >= (threshold if rule.resets else LEAST_COUNT)
    codebook = state.codebook
    if rule.averages:
        # The count of a dead code may be 0 or denormal. Dividing by it would give NaN, also in the unused branch.
        codebook = jnp.where(alive[:, None], ema_sum / jnp.where(alive, ema_count, 1.0)[:, None], codebook)
    if rule.resets:
        codebook = jnp.where(alive[:, None], codebook, candidates)
    return CodebookState(codebook, ema_sum, ema_count, state.initialised)


class Quantizer(nn.Module):
    """Replaces latents by their nearest codes and, in training, moves the codebook towards the latents.

    With `orig` the codebook is the parameter `codebook` [K, C]. Otherwise it is the collection `codebook`:
    `codebook` [K, C], `ema_sum` [K, C], `ema_count` [K], `initialised` []. The collection changes only if `train` is
    True and it is mutable. RNG stream `codebook` (training): noise on repeated candidates.
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
            self.embedding = self.param("codebook", uniform_init(1.0 / self.num_codes), rows)
            return
        self.codebook = self.variable("codebook", "codebook", jnp.zeros, rows)
        self.ema_sum = self.variable("codebook", "ema_sum", jnp.zeros, rows)
        self.ema_count = self.variable("codebook", "ema_count", jnp.zeros, counts)
        self.initialised = self.variable("codebook", "initialised", lambda: jnp.array(False))

    def _read(self) -> CodebookState:
        return CodebookState(self.codebook.value, self.ema_sum.value, self.ema_count.value, self.initialised.value)

    def _write(self, state: CodebookState) -> None:
        self.codebook.value, self.ema_sum.value, self.ema_count.value, self.initialised.value = state

    def __call__(
        self,
        latents: Float[Array, "B N C"],
        mask: Bool[Array, "B N"],
        *,
        train: bool,
        noise: Float[Array, "2 K C"] | None = None,
    ) -> QuantizerOutput:
        """Returns quantized latents, codes and the commitment loss, computed with the codebook from before the step.

        Args:
            latents: What to quantize.
            mask: Positions that count.
            train: Whether the codebook moves.
            noise: Standard normal numbers for the first codebook and for replaced codes. Drawn if None.
        """
        # All of the codebook is in full precision, whatever the latents have.
        rows, row_mask = latents.reshape(-1, self.code_dim).astype(jnp.float32), mask.reshape(-1)
        rule, detached = RULES[self.kind], jax.lax.stop_gradient(rows)
        moves = train and not rule.by_gradient and self.is_mutable_collection("codebook") and not self.is_initializing()

        def candidates(use: int) -> Float[Array, "K C"]:
            shape = (self.num_codes, self.code_dim)
            drawn = jax.random.normal(self.make_rng("codebook"), shape) if noise is None else noise[use]
            return candidate_codes(detached, row_mask, drawn)

        if moves:
            self._write(initial_codebook(self._read(), candidates(0)))
        codebook = self._codebook()
        codes = nearest_codes(rows, codebook)
        batch_hits = hits(detached, codes, row_mask, num_codes=self.num_codes)
        quantized = codebook[codes]
        loss = masked_mean((rows - jax.lax.stop_gradient(quantized)) ** 2, row_mask[:, None])
        if rule.by_gradient:
            loss += masked_mean((quantized - detached) ** 2, row_mask[:, None])
        if moves:
            limits = {"decay": self.ema_decay, "threshold": self.reset_threshold}
            self._write(update_codebook(self._read(), batch_hits, candidates(1), rule=rule, **limits))
        straight_through = rows + jax.lax.stop_gradient(quantized - rows)
        straight_through = straight_through.reshape(latents.shape).astype(latents.dtype)
        return QuantizerOutput(straight_through, codes.reshape(mask.shape), loss, batch_hits[1])

    def _codebook(self) -> Float[Array, "K C"]:
        return self.embedding if RULES[self.kind].by_gradient else self.codebook.value

    def lookup(self, codes: Int[Array, "B N"]) -> Float[Array, "B N C"]:
        """Returns the codebook rows of `codes`."""
        return self._codebook()[codes]
