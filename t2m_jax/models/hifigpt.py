"""The double-tier GPT of T2M-HiFiGPT (arXiv 2312.10628, section 3.3): a transformer over rows, and one over depths.

The temporal tier reads the text and the rows so far and gives a context. The residual tier reads the context and
predicts the R codes of the next row one by one. A stop head says which row is the last. `docs/hifigpt.md` lists the
equations, and what the paper leaves open.
"""

import dataclasses
from typing import Any, ClassVar, Literal, NamedTuple

import chex
import flax.linen as nn
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.field_checks import check_limits, check_shares, check_sizes, check_transformer
from t2m_jax.models.projection import WEIGHT_INIT, Projection
from t2m_jax.models.system import Draw, Part, Randomness, draw_depths, draw_each, log_probabilities
from t2m_jax.models.transformer import LAYER_NORM_EPSILON, Block, LayerCache, empty_cache, read_causal, read_one


@dataclasses.dataclass(frozen=True, kw_only=True)
class HiFiGptConfig:
    """Sizes of the double-tier GPT; the defaults are the paper's HumanML3D model."""

    kind: ClassVar[str] = "hifigpt"

    num_codes: int = 256
    """Codes of the tokenizer (K). Training takes it from the tokenizer."""
    num_quantizers: int = 10
    """Codes per row (R). Training takes it from the tokenizer."""
    code_dim: int = 512
    """Width of a code (C). Training takes it from the tokenizer."""
    embed_dim: int = 512
    """Width of both tiers (W)."""
    text_dim: int = 512
    """Width of the text embedding (E)."""
    num_layers: int = 9
    """Blocks of the temporal tier."""
    num_residual_layers: int = 9
    """Blocks of the residual tier."""
    num_heads: int = 16
    """Attention heads; must divide embed_dim."""
    mlp_ratio: int = 4
    """Width of a block's MLP over embed_dim."""
    max_codes: int = 24
    """Rows of the longest motion."""
    dropout: float = 0.1
    """Dropout rate in attention and MLP."""
    code_embedding: Literal["projected", "frozen", "learned"] = "projected"
    """How tiers read codes: the tokenizer's codebook through a linear layer of each tier, the codebook as it is (then
    code_dim must be embed_dim), or a table that is learned."""
    cumulative_depth: bool = False
    """Whether the residual tier reads the sum of a row's codes so far, and not the last code alone."""
    head: Literal["shared", "per_depth"] = "shared"
    """Whether all depths are predicted by one matrix, or each by its own."""
    stop_rule: Literal["argmax", "threshold", "sampled"] = "argmax"
    """Which row is the last: the one with the highest stop probability, the first that reaches `stop_threshold`, or
    each with its stop probability."""
    stop_threshold: float = 0.5
    """Stop probability at which a motion ends, with `stop_rule: threshold`."""
    guidance_scale: float = 4.0
    """Strength of the guidance by the text if the user gives none; 1 is no guidance."""

    def __post_init__(self) -> None:
        check_sizes(self)
        check_transformer(self, num_codes=1_000_000, num_quantizers=64, code_dim=65_536, text_dim=65_536)
        check_limits(self, num_residual_layers=64, mlp_ratio=64, max_codes=4096)
        check_shares(self, "dropout", with_one=False)
        if self.code_embedding == "frozen" and self.code_dim != self.embed_dim:
            raise ValueError(
                f"code_embedding: frozen needs code_dim {self.code_dim} to be embed_dim {self.embed_dim}; use projected"
            )
        if not 0 <= self.guidance_scale < float("inf"):
            raise ValueError(f"guidance_scale: {self.guidance_scale} is not a number from 0")
        if not 0 < self.stop_threshold <= 1:
            raise ValueError(f"stop_threshold: {self.stop_threshold} is not a probability above 0 and at most 1")


class HiFiGptOutput(NamedTuple):
    """Predictions for all rows of some motions."""

    code_logits: Float[Array, "B N R K"]
    """Those at row t and depth w see the text, the rows before t, and the codes before w of row t."""
    stop_logits: Float[Array, "B N"]
    """Of row t being the last; they see the rows up to t."""


class Context(NamedTuple):
    """What the next row is drawn from: with guidance, for the text and for no text (G = 2, else 1)."""

    hidden: Float[Array, "B G W"]
    guidance_scale: Float[Array, " B"]


class Cache(NamedTuple):
    """What the temporal tier has read so far."""

    layers: tuple[LayerCache, ...]
    """Of B * G sequences: motion b without text follows motion b with text."""
    guidance_scale: Float[Array, " B"]
    position: Int[Array, ""]
    """Of the next input: 0 for the text, t for row t (counted from 1)."""


class Tier(nn.Module):
    """A stack of causal blocks, with positions and the layer through which codes are read."""

    config: HiFiGptConfig
    num_layers: int
    num_positions: int
    """Codes or rows that can be read after the prompt."""
    remat: bool

    def setup(self) -> None:
        """Builds positions and blocks."""
        config = self.config
        if config.code_embedding == "projected":
            self.project = Projection(config.embed_dim)
        # Weights that were read from a file are NumPy arrays.
        if self.num_positions:
            self.position = jnp.asarray(self.param("position", WEIGHT_INIT, (self.num_positions, config.embed_dim)))
        self.blocks = [
            Block(config.num_heads, config.mlp_ratio, config.dropout, name=f"block_{layer}")
            for layer in range(self.num_layers)
        ]

    def _read_vectors(self, vectors: Float[Array, "*B C"]) -> Float[Array, "*B W"]:
        return self.project(vectors) if self.config.code_embedding == "projected" else vectors

    def embed(self, vectors: Float[Array, "*B L C"]) -> Float[Array, "*B L W"]:
        """Returns inputs for code vectors at the first L positions after the prompt."""
        inputs = self._read_vectors(vectors)
        if not self.num_positions:
            return inputs
        positions = self.position[: inputs.shape[-2]]
        return inputs + positions.reshape((1,) * (inputs.ndim - 2) + positions.shape)

    def embed_at(self, vectors: Float[Array, "B C"], number: Int[Array, ""]) -> Float[Array, "B W"]:
        """Returns the input for code vectors at one position after the prompt, counted from 0."""
        inputs = self._read_vectors(vectors)
        if not self.num_positions:
            return inputs
        # The last depth is read, too, in a scan; nobody uses what comes of it.
        return inputs + self.position[jnp.minimum(number, self.num_positions - 1)][None]

    def __call__(self, inputs: Float[Array, "B L W"], *, train: bool) -> Float[Array, "B L W"]:
        """Returns the sequence after all blocks."""
        return read_causal(self.blocks, inputs, train=train, remat=self.remat)

    def empty(self, batch: int) -> tuple[LayerCache, ...]:
        """Returns an empty cache for the prompt and all positions."""
        config = self.config
        layer = empty_cache(batch, self.num_positions + 1, embed_dim=config.embed_dim, num_heads=config.num_heads)
        return (layer,) * self.num_layers

    def step(
        self, inputs: Float[Array, "B W"], layers: tuple[LayerCache, ...], position: Int[Array, ""]
    ) -> tuple[Float[Array, "B W"], tuple[LayerCache, ...]]:
        """Returns the output for one more input, and the cache with it."""
        return read_one(self.blocks, inputs, layers, position)


class HiFiGpt(nn.Module):
    """Predicts the R codes of the next row from the text and the rows so far, and whether a row is the last.

    Collections: `params`, and `codebook` with the tokenizer's `codebook` [K, C], which is not trained (none with
    `code_embedding: learned`). RNG stream `dropout` when training.
    """

    config: HiFiGptConfig
    remat: bool = False
    """Whether the intermediate values of blocks are computed again for the gradient."""

    def setup(self) -> None:
        """Builds the tiers and the heads."""
        config = self.config
        # Weights that were read from a file are NumPy arrays.
        if config.code_embedding == "learned":
            self.table = jnp.asarray(self.param("embedding", WEIGHT_INIT, (config.num_codes, config.embed_dim)))
        else:
            self.codebook = self.variable("codebook", "codebook", jnp.zeros, (config.num_codes, config.code_dim))
        self.text_projection = Projection(config.embed_dim)
        self.temporal = Tier(config, config.num_layers, config.max_codes, self.remat)
        self.residual = Tier(config, config.num_residual_layers, config.num_quantizers - 1, self.remat)
        self.stop_norm = nn.LayerNorm(epsilon=LAYER_NORM_EPSILON)
        self.stop_head = Projection(1)
        self.head_norm = nn.LayerNorm(epsilon=LAYER_NORM_EPSILON)
        if config.head == "shared":
            self.head = Projection(config.num_codes, use_bias=False)
        else:
            shape = (config.num_quantizers, config.embed_dim, config.num_codes)
            self.heads = jnp.asarray(self.param("heads", WEIGHT_INIT, shape))

    def _vectors(self, codes: Int[Array, "*B"]) -> Float[Array, "*B C"]:
        return (self.table if self.config.code_embedding == "learned" else jnp.asarray(self.codebook.value))[codes]

    def _stop_logits(self, hidden: Float[Array, "*B W"]) -> Float[Array, "*B"]:
        return self.stop_head(self.stop_norm(hidden))[..., 0]

    def __call__(
        self,
        codes: Int[Array, "B N R"],
        text_embedding: Float[Array, "B E"],
        residual_codes: Int[Array, "B N R"] | None = None,
        *,
        train: bool,
    ) -> HiFiGptOutput:
        """Returns logits of all codes and of stopping.

        Args:
            codes: What the tiers read.
            text_embedding: One text per motion; zeros for no text.
            residual_codes: What the residual tier reads, if it is something else.
            train: Whether dropout is on.
        """
        chex.assert_shape(codes, (None, None, self.config.num_quantizers))
        chex.assert_shape(text_embedding, (len(codes), self.config.text_dim))
        if codes.shape[1] > self.config.max_codes:
            raise ValueError(f"{codes.shape[1]} rows are more than max_codes {self.config.max_codes}")
        # The codes of row t are read off the context after row t - 1, and whether it is the last off that after itself.
        hidden = self.contexts(codes, text_embedding, train=train)
        read = codes if residual_codes is None else residual_codes
        return HiFiGptOutput(self._code_logits(hidden[:, :-1], read, train=train), self._stop_logits(hidden[:, 1:]))

    def contexts(
        self, codes: Int[Array, "B N R"], text_embedding: Float[Array, "B E"], *, train: bool
    ) -> Float[Array, "B N+1 W"]:
        """Returns the outputs of the temporal tier: after the text, and after each row."""
        text = self.text_projection(text_embedding)[:, None]
        rows = self.temporal.embed(self._vectors(codes).sum(axis=2))
        return self.temporal(jnp.concatenate([text, rows], axis=1), train=train)

    def log_likelihood(self, codes: Int[Array, "B N R"], text_embedding: Float[Array, "B E"]) -> Float[Array, "B N"]:
        """Returns the logarithm of the probability of each row after the text and the rows before it."""
        logits = self(codes, text_embedding, train=False).code_logits
        return log_probabilities(logits, codes).sum(axis=-1)

    def _code_logits(
        self, contexts: Float[Array, "B N W"], codes: Int[Array, "B N R"], *, train: bool
    ) -> Float[Array, "B N R K"]:
        """Returns the logits of rows, each of which is a sequence of its own for the residual tier."""
        batch, rows, depth = codes.shape
        vectors = self._vectors(codes[:, :, :-1])
        if self.config.cumulative_depth:
            vectors = jnp.cumsum(vectors, axis=2)
        # A context is the prompt, so depth w sees the codes before it, and the last code is never read.
        inputs = jnp.concatenate([contexts[:, :, None], self.residual.embed(vectors)], axis=2)
        hidden = self.residual(inputs.reshape(batch * rows, depth, -1), train=train)
        normed = self.head_norm(hidden).reshape(batch, rows, depth, -1)
        if self.config.head == "shared":
            return self.head(normed)
        return jnp.einsum("bnrw,rwk->bnrk", normed, self.heads)

    def begin(
        self, text_embedding: Float[Array, "B E"], guidance_scale: Float[Array, ""] | None = None
    ) -> tuple[Context, Cache]:
        """Returns the context of the first row, and a cache that contains the text.

        With a scale, every motion is computed with its text and without, in one batch.
        """
        chex.assert_shape(text_embedding, (None, self.config.text_dim))
        batch = text_embedding.shape[0]
        texts = text_embedding[:, None]
        if guidance_scale is not None:  # zeros are what a motion without text had in training
            texts = jnp.concatenate([texts, jnp.zeros_like(texts)], axis=1)
        scale = jnp.full(batch, 1.0 if guidance_scale is None else guidance_scale)
        inputs = self.text_projection(texts.reshape(-1, texts.shape[-1]))
        empty = Cache(self.temporal.empty(len(inputs)), scale, jnp.array(0, jnp.int32))
        return self._read(inputs, empty)

    def _read(self, inputs: Float[Array, "M W"], cache: Cache) -> tuple[Context, Cache]:
        """Returns the context after one more input of the temporal tier, and the cache with it."""
        # The sampling loop works in chunks and may go past the last row. Those rows are thrown away.
        position = jnp.minimum(cache.position, self.config.max_codes)
        hidden, layers = self.temporal.step(inputs, cache.layers, position)
        context = Context(hidden.reshape(len(cache.guidance_scale), -1, hidden.shape[-1]), cache.guidance_scale)
        return context, Cache(layers, cache.guidance_scale, cache.position + 1)

    def draw(
        self, context: Context, keys: Randomness, strategy: Draw, *, may_stop: Bool[Array, "*#B"]
    ) -> Int[Array, "B R"]:
        """Returns the next row, code after code; `keys` are consumed."""
        del may_stop  # rows never end a motion; their stop scores do
        batch, halves, width = context.hidden.shape

        def one_depth(
            self: "HiFiGpt", carry: tuple[Array, Array, Any], now: tuple[Array, Array]
        ) -> tuple[tuple[Array, Array, Any], Array]:
            inputs, total, layers = carry
            number, keys = now
            hidden, layers = self.residual.step(inputs, layers, number)
            logits = guided(self._logits_at(hidden, number).reshape(batch, halves, -1), context.guidance_scale)
            # Both halves read the same codes: they are two opinions on one motion.
            codes = draw_each(strategy, logits, keys)
            vectors = self._vectors(codes)
            total = total + vectors
            read = self.residual.embed_at(total if self.config.cumulative_depth else vectors, number)
            return (jnp.repeat(read, halves, axis=0), total, layers), codes

        total = jnp.zeros_like(self._vectors(jnp.zeros(batch, jnp.int32)))
        first = (context.hidden.reshape(-1, width), total, self.residual.empty(batch * halves))
        # The cache of this tier starts empty for each row.
        return draw_depths(one_depth, self, first, keys, depth=self.config.num_quantizers)

    def _logits_at(self, hidden: Float[Array, "B W"], depth: Int[Array, ""]) -> Float[Array, "B K"]:
        normed = self.head_norm(hidden)
        return self.head(normed) if self.config.head == "shared" else normed @ self.heads[depth]

    def step(self, cache: Cache, rows: Int[Array, "B R"]) -> tuple[Context, Float[Array, " B"], Cache]:
        """Returns the context after `rows`, the logit of each of being the last, and the cache."""
        vectors = self._vectors(rows).sum(axis=1)
        inputs = self.temporal.embed_at(vectors, cache.position - 1)
        halves = cache.layers[0].keys.shape[0] // len(rows)
        context, cache = self._read(jnp.repeat(inputs, halves, axis=0), cache)
        return context, guided(self.stop_head(self.stop_norm(context.hidden)), context.guidance_scale)[:, 0], cache


def guided(logits: Float[Array, "B G K"], scale: Float[Array, " B"]) -> Float[Array, "B K"]:
    """Returns the logits with text, moved away from those without text, if there are any (classifier-free guidance)."""
    if logits.shape[1] == 1:
        return logits[:, 0]
    return logits[:, 1] + scale[:, None] * (logits[:, 0] - logits[:, 1])


PART = Part(
    role="generator",
    config=HiFiGptConfig,
    module=HiFiGpt,
    example=lambda config: (jnp.zeros((1, 1, config.num_quantizers), jnp.int32), jnp.zeros((1, config.text_dim))),
    stop_threshold=lambda config: config.stop_threshold,
)
"""The entry point `hifigpt`."""
