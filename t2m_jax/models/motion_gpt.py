"""The generator of T2M-GPT (arXiv 2301.06052, section 3.2): a causal transformer over one code per row.

Tokens are codes, then End, then Pad. A motion ends when End is drawn.
"""

import dataclasses
from typing import Any, ClassVar, NamedTuple

import chex
import flax.linen as nn
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.errors import UserError
from t2m_jax.field_checks import check_shares, check_sizes, check_transformer
from t2m_jax.models.projection import WEIGHT_INIT, Projection
from t2m_jax.models.system import Draw, Part, Randomness, draw_each, log_probabilities
from t2m_jax.models.transformer import LAYER_NORM_EPSILON, Block, LayerCache, empty_cache, read_causal, read_one


@dataclasses.dataclass(frozen=True, kw_only=True)
class MotionGptConfig:
    """Sizes of the GPT; the defaults are the published HumanML3D model."""

    kind: ClassVar[str] = "gpt"
    num_quantizers: ClassVar[int] = 1
    stop_rule: ClassVar[str] = "end"
    guidance_scale: ClassVar[None] = None

    num_codes: int = 512
    """Codes of the tokenizer (K); tokens K and K+1 are End and Pad. Training takes it from the tokenizer."""
    embed_dim: int = 1024
    """Width of the transformer."""
    text_dim: int = 512
    """Width of the text embedding (E)."""
    num_layers: int = 18
    """Blocks; the original calls the first half its base and the second its head."""
    num_heads: int = 16
    """Attention heads; must divide embed_dim."""
    mlp_ratio: int = 4
    """Width of a block's MLP over embed_dim."""
    block_size: int = 51
    """Longest sequence: the text and block_size - 1 codes."""
    dropout: float = 0.1
    """Dropout rate in attention and MLP."""

    def __post_init__(self) -> None:
        check_sizes(self)
        check_transformer(self, num_codes=1_000_000, text_dim=65_536, mlp_ratio=64, block_size=4096)
        check_shares(self, "dropout", with_one=False)
        if self.block_size < 2:
            raise ValueError(f"block_size: {self.block_size} leaves no position for a code after the text")

    @property
    def end_token(self) -> int:
        """The token that ends a motion."""
        return self.num_codes

    @property
    def max_codes(self) -> int:
        """The longest motion that can be generated, in codes."""
        return self.block_size - 1


def sinusoidal_table(length: int, dim: int) -> np.ndarray:
    """Returns the fixed position table [length, dim]: sine at even, cosine at odd channels."""
    rates = np.exp(-np.log(10000.0) * np.arange(0, dim, 2) / dim)
    angles = np.arange(length)[:, None] * rates[None, :]
    return np.stack([np.sin(angles), np.cos(angles)], axis=-1).reshape(length, -1)[:, :dim].astype(np.float32)


class MotionGpt(nn.Module):
    """Predicts the next code from the text and the codes so far.

    RNG stream `dropout` when training.
    """

    config: MotionGptConfig
    remat: bool = False
    """Whether the intermediate values of blocks are computed again for the gradient."""

    def setup(self) -> None:
        """Builds embeddings, blocks and head."""
        config = self.config
        # End and Pad are read in training, where motions are shorter than the block.
        self.token_embedding = nn.Embed(config.num_codes + 2, config.embed_dim, embedding_init=WEIGHT_INIT)
        self.text_projection = Projection(config.embed_dim)
        self.blocks = [
            Block(config.num_heads, config.mlp_ratio, config.dropout, name=f"block_{layer}")
            for layer in range(config.num_layers)
        ]
        self.final_norm = nn.LayerNorm(epsilon=LAYER_NORM_EPSILON)
        # Pad is never predicted.
        self.head = Projection(config.num_codes + 1, use_bias=False)

    def _positions(self) -> Float[Array, "L W"]:
        return jnp.asarray(sinusoidal_table(self.config.block_size, self.config.embed_dim))

    def __call__(
        self, tokens: Int[Array, "B L"], text_embedding: Float[Array, "B E"], *, train: bool
    ) -> Float[Array, "B L+1 V"]:
        """Returns logits over codes and End; those at position p predict token p (position 0 is the text)."""
        chex.assert_rank(tokens, 2)
        chex.assert_shape(text_embedding, (len(tokens), self.config.text_dim))
        length = tokens.shape[1] + 1
        if length > self.config.block_size:
            raise ValueError(f"{length - 1} tokens do not fit a block size of {self.config.block_size}")
        text = self.text_projection(text_embedding)[:, None]
        hidden = jnp.concatenate([text, self.token_embedding(tokens)], axis=1)
        # In the dtype of the input: a table in float32 would turn all products after it into float32.
        hidden = hidden + self._positions()[None, :length].astype(hidden.dtype)
        hidden = read_causal(self.blocks, hidden, train=train, remat=self.remat)
        return self.head(self.final_norm(hidden))

    def begin(self, text_embedding: Float[Array, "B E"], guidance_scale: Any = None) -> tuple[Any, "GptCache"]:
        """Returns the logits of the first token, and a cache that contains the text.

        Raises:
            UserError: A guidance scale is given. T2M-GPT is not trained without text, which guidance needs.
        """
        if guidance_scale is not None:
            raise UserError("guidance-scale: this model was not trained for guidance; leave it out")
        config = self.config
        chex.assert_shape(text_embedding, (None, config.text_dim))
        empty = empty_cache(
            text_embedding.shape[0], config.block_size, embed_dim=config.embed_dim, num_heads=config.num_heads
        )
        cache = GptCache((empty,) * config.num_layers, jnp.array(0, jnp.int32))
        return self._read(self.text_projection(text_embedding), cache)

    def draw(
        self, context: Float[Array, "B V"], keys: Randomness, strategy: Draw, *, may_stop: Bool[Array, "*#B"]
    ) -> Int[Array, "B 1"]:
        """Returns the next token, which is a code or (if `may_stop`) End."""
        # A motion that must go on, because it is too short or not yet where the user wants it.
        is_end = jnp.arange(context.shape[1]) == self.config.end_token
        allowed = jnp.where(is_end[None] & ~may_stop.reshape(-1, 1), -jnp.inf, context)
        return draw_each(strategy, allowed, keys)[:, None]

    def step(
        self, cache: "GptCache", rows: Int[Array, "B 1"]
    ) -> tuple[Float[Array, "B V"], Float[Array, " B"], "GptCache"]:
        """Returns the logits after `rows`, 1 for each End in them and 0 for codes, and the cache."""
        logits, cache = self._read(self.token_embedding(rows[:, 0]), cache)
        return logits, (rows[:, 0] == self.config.end_token).astype(jnp.float32), cache

    def log_likelihood(self, codes: Int[Array, "B N 1"], text_embedding: Float[Array, "B E"]) -> Float[Array, "B N"]:
        """Returns the logarithm of the probability of each code after the text and the codes before it."""
        logits = self(codes[:, :-1, 0], text_embedding, train=False)
        return log_probabilities(logits, codes[:, :, 0])

    def _read(self, inputs: Float[Array, "B W"], cache: "GptCache") -> tuple[Float[Array, "B V"], "GptCache"]:
        """Returns the logits after one more input, and the cache with it."""
        # The sampling loop works in chunks and may go past the last position. Those rows are thrown away.
        position = jnp.minimum(cache.position, self.config.block_size - 1)
        hidden, layers = read_one(self.blocks, inputs + self._positions()[position][None], cache.layers, position)
        return self.head(self.final_norm(hidden)), GptCache(layers, cache.position + 1)


class GptCache(NamedTuple):
    """What the GPT has read so far."""

    layers: tuple[LayerCache, ...]
    position: Int[Array, ""]
    """Of the next input: 0 for the text, 1 for the first code."""


def _example(config: MotionGptConfig) -> tuple[Any, ...]:
    return jnp.zeros((1, config.max_codes), jnp.int32), jnp.zeros((1, config.text_dim))


PART = Part(role="generator", config=MotionGptConfig, module=MotionGpt, example=_example)
"""The entry point `gpt`."""
