"""Vector quantization: nearest-code lookup, once or residual, with a codebook that learns (`models/codebook.py`).

Residual quantization (RQ-VAE, arXiv 2203.01941; T2M-HiFiGPT, arXiv 2312.10628, section 3.2) looks up the latent, then
what is left of it, and so on. R codes of one shared codebook add up to the quantized latent. R = 1 is a plain layer.
"""

import functools
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.masks import masked_mean
from t2m_jax.models.codebook import (
    RULES,
    CodebookState,
    QuantizerKind,
    candidate_codes,
    count_codes,
    draw_codes,
    hits,
    initial_codebook,
    make_pool,
    redraw_dead,
    update_codebook,
)
from t2m_jax.models.convolution import uniform_init

CodebookUpdate = Literal["joint", "per_depth"]
CommitmentKind = Literal["mean", "sum"]
Move = Callable[..., tuple[CodebookState, Float[Array, " R"]]]
"""From a state, vectors [R, M, C], codes [R, M], used depths [R] and random draws to the next state and the number of
codes that were redrawn from each depth."""


class QuantizerOutput(NamedTuple):
    """One pass through the codebook."""

    quantized: Float[Array, "B N C"]
    """Straight-through: the value of the sum of the codes, the gradient of the latent."""
    codes: Int[Array, "B N R"]
    commitment_loss: Float[Array, ""]
    """Mean squared distance of latents and the sums of their first codes, averaged or added up over the depths. If the
    codebook learns by gradient, its own loss is added: the same value, with the gradient to the codes."""
    code_counts: Float[Array, "R K"]
    """How often each code was chosen in this batch at each depth, masked positions not counted."""
    residual_norms: Float[Array, " R"]
    """Mean length of what each depth looked up."""
    expired: Float[Array, " R"]
    """Codes that were replaced by a vector of each depth."""


class Lookup(NamedTuple):
    """What each depth looked up, and what was found."""

    codes: Int[Array, "R M"]
    residuals: Float[Array, "R M C"]
    """What depth w looked up; the latents at the first depth."""
    totals: Float[Array, "R M C"]
    """Sums of the first codes."""
    expired: Float[Array, "R _"]


def nearest_codes(latents: Float[Array, "M C"], codebook: Float[Array, "K C"]) -> Int[Array, " M"]:
    """Returns the index of the nearest code by squared distance; ties go to the lowest index."""
    # Full precision on every device: with TF32, one code in a thousand differs.
    products = jnp.matmul(latents, codebook.T, precision=jax.lax.Precision.HIGHEST)
    distances = jnp.sum(codebook**2, axis=1)[None, :] - 2.0 * products
    return jnp.argmin(distances, axis=1)


def look_up(
    rows: Float[Array, "M C"],
    state: CodebookState,
    used: Bool[Array, " R"],
    *,
    draws: Array | None = None,
    move: Move | None = None,
) -> tuple[Lookup, CodebookState]:
    """Returns the codes of latents at all depths, and the state after them.

    Args:
        rows: The latents.
        state: The codebook; only its codes are read.
        used: Depths that count. The others add nothing.
        draws: What `move` gets at each depth [R, ...].
        move: Changes the codebook after the lookup of each depth, before that of the next.
    """

    def one_depth(carry: Any, now: Any) -> tuple[Any, Lookup]:
        residual, total, state = carry
        is_used, draw = now
        codes = nearest_codes(residual, state.codebook)
        chosen = jnp.where(is_used, state.codebook[codes], 0.0)
        expired = jnp.zeros(1)
        if move is not None:
            state, expired = move(state, residual[None], codes[None], is_used[None], draw)
        return (residual - chosen, total + chosen, state), Lookup(codes, residual, total + chosen, expired)

    (_, _, state), found = jax.lax.scan(one_depth, (rows, jnp.zeros_like(rows), state), (used, draws))
    return found, state


class Quantizer(nn.Module):
    """Replaces latents by sums of their nearest codes and, in training, moves the codebook toward the latents.

    With `orig` the codebook is the parameter `codebook` [K, C]. Otherwise it is the collection `codebook`:
    `codebook` [K, C], `ema_sum` [K, C], `ema_count` [K], `initialised` []. The collection changes only if `train` is
    True and it is mutable. RNG stream `codebook` (training): noise on repeated candidates, and drawn codes.
    """

    num_codes: int
    code_dim: int
    kind: QuantizerKind
    ema_decay: float
    reset_threshold: float
    num_quantizers: int = 1
    codebook_update: CodebookUpdate = "joint"
    commitment: CommitmentKind = "mean"
    depth_dropout: float = 0.0

    def setup(self) -> None:
        """Declares the codebook."""
        rows = (self.num_codes, self.code_dim)
        if RULES[self.kind].by_gradient:
            self.embedding = self.param("codebook", uniform_init(1.0 / self.num_codes), rows)
            return
        self.codebook = self.variable("codebook", "codebook", jnp.zeros, rows)
        self.ema_sum = self.variable("codebook", "ema_sum", jnp.zeros, rows)
        self.ema_count = self.variable("codebook", "ema_count", jnp.zeros, (self.num_codes,))
        self.initialised = self.variable("codebook", "initialised", lambda: jnp.array(False))

    def _read(self) -> CodebookState:
        if RULES[self.kind].by_gradient:
            unused = jnp.zeros(())
            return CodebookState(self.embedding, unused, unused, unused)
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
        """Returns quantized latents, codes and the commitment loss.

        All depths look up the codebook from before the step, unless `codebook_update` is `per_depth` in training.

        Args:
            latents: What to quantize.
            mask: Positions that count.
            train: Whether the codebook moves.
            noise: Standard normal numbers for the first codebook and for replaced codes. Drawn if None.
        """
        # All of the codebook is in full precision, whatever the latents have.
        rows = latents.reshape(-1, self.code_dim).astype(jnp.float32)
        row_mask = mask.reshape(-1)
        used = self._used_depths(train=train)
        if train and self._can_move():
            found, expired = self._look_up_and_move(rows, row_mask, used, noise)
        else:
            found, _ = look_up(rows, self._read(), used)
            expired = jnp.zeros(self.num_quantizers)
        counted = used[:, None] & row_mask[None]
        residuals = jax.lax.stop_gradient(found.residuals)
        # One estimator for the total: with one at each depth, the gradient would be counted R times.
        straight_through = rows + jax.lax.stop_gradient(found.totals[-1] - rows)
        return QuantizerOutput(
            quantized=straight_through.reshape(latents.shape).astype(latents.dtype),
            codes=found.codes.T.reshape(*mask.shape, self.num_quantizers),
            commitment_loss=self._commitment_loss(rows, found.totals, row_mask, used),
            code_counts=count_codes(found.codes, counted, num_codes=self.num_codes),
            residual_norms=jax.vmap(masked_mean, (0, None))(jnp.linalg.norm(residuals, axis=-1), row_mask),
            expired=expired,
        )

    def _can_move(self) -> bool:
        by_gradient = RULES[self.kind].by_gradient
        return not by_gradient and self.is_mutable_collection("codebook") and not self.is_initializing()

    def _used_depths(self, *, train: bool) -> Bool[Array, " R"]:
        """Returns which depths are used: with probability `depth_dropout`, only a random number of the first."""
        depths = jnp.arange(self.num_quantizers)
        # One number for the whole batch, so that the codebook sees the same depths of all motions.
        if not (train and self.depth_dropout > 0) or self.is_initializing():
            return depths >= 0
        drop_key, count_key = jax.random.split(self.make_rng("codebook"))
        count = jax.random.randint(count_key, (), 1, self.num_quantizers + 1)
        return (depths < count) | ~jax.random.bernoulli(drop_key, self.depth_dropout)

    def _look_up_and_move(
        self, rows: Float[Array, "M C"], mask: Bool[Array, " M"], used: Bool[Array, " R"], noise: Array | None
    ) -> tuple[Lookup, Float[Array, " R"]]:
        """Returns the codes, and how many codes were redrawn from each depth; moves the codebook."""
        first, draws = self._first_codes(jax.lax.stop_gradient(rows), mask, noise)
        state = initial_codebook(self._read(), first)
        move = functools.partial(self._move, mask)
        if self.codebook_update == "per_depth":
            found, state = look_up(rows, state, used, draws=draws, move=move)
            expired = found.expired[:, 0]
        else:
            found, _ = look_up(rows, state, used)
            state, expired = move(state, found.residuals, found.codes, used, draws[0])
        self._write(state)
        return found, expired

    def _first_codes(
        self, rows: Float[Array, "M C"], mask: Bool[Array, " M"], noise: Array | None
    ) -> tuple[Float[Array, "K C"], Array]:
        """Returns a first codebook, and what the update after each depth draws from: keys, or noise."""
        if RULES[self.kind].redraws:
            keys = jax.random.split(self.make_rng("codebook"), self.num_quantizers + 1)
            state = self._read()

            def draw() -> Float[Array, "K C"]:
                # Rows alone would be no code for the small residuals of later depths, so these are in the pool as well.
                provisional = candidate_codes(rows, mask, jnp.zeros_like(state.codebook))
                used = jnp.ones(self.num_quantizers, bool)
                found, _ = look_up(rows, state._replace(codebook=provisional), used)
                return draw_codes(make_pool(found.residuals, used[:, None] & mask[None]), provisional, keys[0])

            return jax.lax.cond(state.initialised, lambda: state.codebook, draw), keys[1:]
        if noise is None:
            shape = (self.num_codes, self.code_dim)
            noise = jnp.stack([jax.random.normal(self.make_rng("codebook"), shape) for _ in range(2)])
        draws = jnp.broadcast_to(noise[1], (self.num_quantizers, *noise.shape[1:]))
        return candidate_codes(rows, mask, noise[0]), draws

    def _move(
        self,
        mask: Bool[Array, " M"],
        state: CodebookState,
        vectors: Float[Array, "D M C"],
        codes: Int[Array, "D M"],
        used: Bool[Array, " D"],
        draw: Array,
    ) -> tuple[CodebookState, Float[Array, " D"]]:
        """Returns the codebook after the lookup of D depths, and how many codes were redrawn from each.

        Args:
            mask: Positions that count.
            state: The codebook that was used.
            vectors: What was looked up.
            codes: What was found.
            used: Depths that count.
            draw: Standard normal noise for candidates; or a key, if the rule redraws.
        """
        counted = used[:, None] & mask[None]
        rule = RULES[self.kind]
        # The codebook follows the latents; no gradient flows through its move.
        vectors = jax.lax.stop_gradient(vectors)
        candidates = None
        if rule.resets and not rule.redraws:
            candidates = candidate_codes(vectors.reshape(-1, self.code_dim), counted.reshape(-1), draw)
        batch_hits = hits(vectors, codes, counted, num_codes=self.num_codes)
        state = update_codebook(
            state, batch_hits, candidates, rule=rule, decay=self.ema_decay, threshold=self.reset_threshold
        )
        if not rule.redraws:
            return state, jnp.zeros(len(codes))
        return redraw_dead(state, make_pool(vectors, counted), draw, threshold=self.reset_threshold, depth=len(codes))

    def _commitment_loss(
        self, rows: Float[Array, "M C"], totals: Float[Array, "R M C"], mask: Bool[Array, " M"], used: Bool[Array, " R"]
    ) -> Float[Array, ""]:
        """Returns the distance of latents and codes over the depths that are used."""

        def mean_squares(ours: Array, theirs: Array) -> Float[Array, ""]:
            return masked_mean((ours - theirs) ** 2, mask[:, None])

        losses = jax.vmap(mean_squares, (None, 0))(rows, jax.lax.stop_gradient(totals))
        if RULES[self.kind].by_gradient:
            losses += jax.vmap(mean_squares, (0, None))(totals, jax.lax.stop_gradient(rows))
        # Depths that were dropped have the totals of the last used one, and would count again.
        total = jnp.sum(jnp.where(used, losses, 0.0))
        return total if self.commitment == "sum" else total / jnp.sum(used)

    def read_codebook(self) -> Float[Array, "K C"]:
        """Returns the codes."""
        return jnp.asarray(self._read().codebook)

    def lookup(self, codes: Int[Array, "B N R"]) -> Float[Array, "B N C"]:
        """Returns the sums of the codebook rows of `codes`: of all depths, or of the first of them."""
        codebook = self.read_codebook()
        # One after the other, as in the lookup, so that the sum is the same to the last bit.
        return functools.reduce(jnp.add, [codebook[codes[..., depth]] for depth in range(codes.shape[-1])])
