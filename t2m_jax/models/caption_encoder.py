"""A small transformer that turns a caption's subword tokens into one text embedding."""

import dataclasses
from typing import ClassVar

import chex
import flax.linen as nn
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.config import check_limits, check_sizes
from t2m_jax.models.projection import WEIGHT_INIT
from t2m_jax.models.transformer import LAYER_NORM_EPSILON, Block


@dataclasses.dataclass(frozen=True, kw_only=True)
class CaptionEncoderConfig:
    """Sizes of the caption encoder."""

    kind: ClassVar[str] = "caption_encoder"

    vocabulary_size: int = 1024
    """Number of subword tokens, including padding."""
    max_length: int = 48
    """Longest caption in tokens. Longer captions are cut."""
    embed_dim: int = 256
    """Width of the transformer."""
    num_layers: int = 2
    """Number of blocks."""
    num_heads: int = 4
    """Number of attention heads; must divide `embed_dim`."""
    mlp_ratio: int = 4
    """Width of a block's MLP divided by `embed_dim`."""
    dropout: float = 0.1
    """Dropout rate in the attention and the MLP."""
    text_dim: int = 256
    """Width of the text embedding (E)."""

    def __post_init__(self) -> None:
        check_sizes(self)
        check_limits(self, vocabulary_size=1_000_000, max_length=4096, embed_dim=16_384, num_layers=64, mlp_ratio=64)
        check_limits(self, text_dim=65_536)
        if self.embed_dim % self.num_heads:
            raise ValueError(f"num_heads: {self.num_heads} does not divide embed_dim {self.embed_dim}")


class CaptionEncoder(nn.Module):
    """Reads a whole caption and returns its embedding. Training uses the RNG stream `dropout`."""

    config: CaptionEncoderConfig

    @nn.compact
    def __call__(
        self, caption_tokens: Int[Array, "B S"], caption_mask: Bool[Array, "B S"], *, train: bool
    ) -> Float[Array, "B E"]:
        """Returns the text embedding. Tokens where the mask is False have no influence."""
        chex.assert_rank(caption_tokens, 2)
        chex.assert_equal_shape([caption_tokens, caption_mask])
        config = self.config
        positions = self.param("position_embedding", WEIGHT_INIT, (config.max_length, config.embed_dim))
        embed = nn.Embed(config.vocabulary_size, config.embed_dim, embedding_init=WEIGHT_INIT, name="token_embedding")
        # Learned positions, because captions are short and all lengths occur in training.
        hidden = embed(caption_tokens) + positions[None, : caption_tokens.shape[1]]
        for layer in range(config.num_layers):
            block = Block(config.num_heads, config.mlp_ratio, config.dropout, name=f"block_{layer}")
            hidden, _ = block(hidden, caption_mask[:, None, None, :], train=train)
        hidden = nn.LayerNorm(epsilon=LAYER_NORM_EPSILON, name="final_norm")(hidden)
        # The mean over the tokens. A caption without tokens gets zeros and not NaN.
        weights = caption_mask / jnp.maximum(caption_mask.sum(axis=1, keepdims=True), 1)
        pooled = jnp.einsum("bs,bsw->bw", weights.astype(hidden.dtype), hidden)
        return nn.Dense(config.text_dim, kernel_init=WEIGHT_INIT, name="projection")(pooled)
