"""The causal transformer of T2M-GPT (arXiv 2301.06052, section 3.2): text embedding and codes so far to next code."""

import dataclasses

import flax.linen as nn
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from t2m_jax.config import check_limits, check_sizes
from t2m_jax.models.transformer import LAYER_NORM_EPSILON, WEIGHT_INIT, Block, LayerCache, empty_cache


@dataclasses.dataclass(frozen=True, kw_only=True)
class MotionGptConfig:
    """Sizes of the GPT; the defaults are the published HumanML3D model."""

    num_codes: int = 512
    """Codes of the VQ-VAE (K); tokens K and K+1 are End and Pad."""
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
        check_limits(self, num_codes=1_000_000, embed_dim=16_384, text_dim=65_536, num_layers=64, mlp_ratio=64)
        check_limits(self, block_size=4096)
        if self.block_size < 2:
            raise ValueError(f"block_size: {self.block_size} has no room for a code beside the text")
        if self.embed_dim % self.num_heads:
            raise ValueError(f"num_heads: {self.num_heads} does not divide embed_dim {self.embed_dim}")

    @property
    def end_token(self) -> int:
        """The token that ends a motion."""
        return self.num_codes

    @property
    def pad_token(self) -> int:
        """The token that fills a target after its end."""
        return self.num_codes + 1

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

    def setup(self) -> None:
        """Builds embeddings, blocks and head."""
        config = self.config
        self.token_embedding = nn.Embed(config.num_codes + 2, config.embed_dim, embedding_init=WEIGHT_INIT)
        self.text_projection = nn.Dense(config.embed_dim, kernel_init=WEIGHT_INIT)
        self.blocks = [
            Block(config.num_heads, config.mlp_ratio, config.dropout, name=f"block_{layer}")
            for layer in range(config.num_layers)
        ]
        self.final_norm = nn.LayerNorm(epsilon=LAYER_NORM_EPSILON)
        self.head = nn.Dense(config.num_codes + 1, use_bias=False, kernel_init=WEIGHT_INIT)

    def _positions(self) -> Float[Array, "L W"]:
        return jnp.asarray(sinusoidal_table(self.config.block_size, self.config.embed_dim))

    def __call__(
        self, tokens: Int[Array, "B L"], text_embedding: Float[Array, "B E"], *, train: bool
    ) -> Float[Array, "B L+1 V"]:
        """Returns logits over codes and End; those at position p predict token p (position 0 is the text)."""
        length = tokens.shape[1] + 1
        if length > self.config.block_size:
            raise ValueError(f"{length - 1} tokens do not fit a block size of {self.config.block_size}")
        text = self.text_projection(text_embedding)[:, None]
        hidden = jnp.concatenate([text, self.token_embedding(tokens)], axis=1)
        hidden = hidden + self._positions()[None, :length]
        causal = jnp.tril(jnp.ones((1, 1, length, length), bool))
        for block in self.blocks:
            hidden, _ = block(hidden, causal, train=train)
        return self.head(self.final_norm(hidden))

    def empty_caches(self, batch: int) -> tuple[LayerCache, ...]:
        """Returns one empty cache a layer, for `batch` sequences."""
        config = self.config
        cache = empty_cache(batch, config.block_size, embed_dim=config.embed_dim, num_heads=config.num_heads)
        return (cache,) * config.num_layers

    def prefill(self, text_embedding: Float[Array, "B E"]) -> tuple[Float[Array, "B V"], tuple[LayerCache, ...]]:
        """Returns the logits of the first token and the caches that hold the text."""
        hidden = self.text_projection(text_embedding)
        return self._step(hidden, self.empty_caches(text_embedding.shape[0]), jnp.array(0))

    def decode_step(
        self, tokens: Int[Array, " B"], caches: tuple[LayerCache, ...], position: Int[Array, ""]
    ) -> tuple[Float[Array, "B V"], tuple[LayerCache, ...]]:
        """Returns the logits that follow `tokens`, which stand at `position` (1 for the first code)."""
        return self._step(self.token_embedding(tokens), caches, position)

    def _step(
        self, hidden: Float[Array, "B W"], caches: tuple[LayerCache, ...], position: Int[Array, ""]
    ) -> tuple[Float[Array, "B V"], tuple[LayerCache, ...]]:
        hidden = (hidden + self._positions()[position][None])[:, None]
        seen = (jnp.arange(self.config.block_size) <= position)[None, None, None, :]
        updated = []
        for block, cache in zip(self.blocks, caches, strict=True):
            hidden, cache = block(hidden, seen, train=False, cache=cache, position=position)
            updated.append(cache)
        return self.head(self.final_norm(hidden))[:, 0], tuple(updated)
