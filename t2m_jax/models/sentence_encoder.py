"""Sentence encoders of the BERT family (arXiv 1810.04805, 1908.10084): the tokens of a caption become one embedding."""

import dataclasses
from typing import Literal

import chex
import flax.linen as nn
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.field_checks import check_amounts, check_limits, check_sizes, check_transformer
from t2m_jax.models.projection import WEIGHT_INIT
from t2m_jax.models.transformer import Attention, layer_norm

MAX_DISTANCE = 128
"""Tokens from which on all distances are in one bucket, in MPNet (arXiv 2004.09297)."""
SHORTEST = 1e-12
"""An embedding that is shorter is divided by this number, not by its length."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SentenceEncoderConfig:
    """Sizes of a sentence encoder; the defaults are BERT's."""

    vocabulary_size: int = 30522
    """Number of subword tokens, including special ones."""
    max_length: int = 512
    """Longest caption in tokens, including special ones. Longer captions are cut."""
    num_positions: int = 512
    """Rows of the table of positions."""
    first_position: int = 0
    """The row of the first token; RoBERTa and MPNet do not use the rows before it."""
    num_types: int = 2
    """Kinds of sentences. A caption is of the first kind. MPNet has none."""
    num_buckets: int = 0
    """Classes of distances between tokens, for MPNet's bias of the attention; 0 for no bias."""
    embed_dim: int = 768
    """Width of the transformer and of the text embedding."""
    num_layers: int = 12
    """Number of blocks."""
    num_heads: int = 12
    """Number of attention heads; must divide `embed_dim`."""
    mlp_dim: int = 3072
    """Width of a block's MLP."""
    activation: Literal["gelu"] = "gelu"
    """Activation of the MLP: the exact GELU."""
    layer_norm_epsilon: float = 1e-12
    """Number that every layer norm adds to the variance."""
    pooling: Literal["mean", "cls"] = "mean"
    """What is read: the mean over all tokens, or the first token."""
    normalize: bool = False
    """Whether embeddings have length 1."""

    def __post_init__(self) -> None:
        check_sizes(self, "vocabulary_size", "max_length", "embed_dim", "num_layers", "num_heads", "mlp_dim")
        check_amounts(self, "first_position", "num_types", "num_buckets", "layer_norm_epsilon")
        check_transformer(self, vocabulary_size=1_000_000, num_positions=16_384, mlp_dim=65_536)
        check_limits(self, num_types=1024, num_buckets=1024)
        if self.first_position + self.max_length > self.num_positions:
            raise ValueError(f"max_length: {self.max_length} tokens do not fit {self.num_positions} positions")
        if self.num_buckets % 4:
            raise ValueError(f"num_buckets: {self.num_buckets} is not a multiple of 4")

    @property
    def text_dim(self) -> int:
        """Width of the text embedding (E)."""
        return self.embed_dim


def distance_buckets(length: int, num_buckets: int) -> Int[np.ndarray, "S S"]:
    """Returns the class of the distance from each token (row) to each other token (column).

    Half of the classes are for later tokens. Near tokens have a class for each distance. The classes of far tokens grow
    in proportion to the distance (T5, arXiv 1910.10683, section 2.1).
    """
    places = np.arange(length, dtype=np.int32)
    half = num_buckets // 2
    ahead = places[None] - places[:, None]
    distance = np.abs(ahead)
    near = half // 2
    # Single precision, because a distance may be at the limit of two classes.
    growth = np.log(np.maximum(distance, near).astype(np.float32) / np.float32(near)) / np.log(MAX_DISTANCE / near)
    far = np.minimum(near + (growth * (half - near)).astype(np.int32), half - 1)
    return np.where(distance < near, distance, far) + half * (ahead > 0)


class SentenceBlock(nn.Module):
    """Attention and an MLP, each with a residual connection and followed by a layer norm."""

    config: SentenceEncoderConfig

    @nn.compact
    def __call__(
        self, hidden: Float[Array, "B S W"], mask: Bool[Array, "B 1 1 S"], bias: Float[Array, "1 H S S"] | None
    ) -> Float[Array, "B S W"]:
        """Returns the sequence after the block."""
        config = self.config
        attended, _ = Attention(config.num_heads, 0.0, name="attn")(hidden, mask, train=False, bias=bias)
        hidden = layer_norm(config.layer_norm_epsilon, "ln1")(hidden + attended)
        wide = nn.Dense(config.mlp_dim, kernel_init=WEIGHT_INIT, name="up")(hidden)
        wide = nn.gelu(wide, approximate=False)
        return layer_norm(config.layer_norm_epsilon, "ln2")(
            hidden + nn.Dense(config.embed_dim, kernel_init=WEIGHT_INIT, name="down")(wide)
        )


class SentenceEncoder(nn.Module):
    """Reads a whole caption, with its special tokens, and returns its embedding."""

    config: SentenceEncoderConfig

    def __call__(self, caption_tokens: Int[Array, "B S"], caption_mask: Bool[Array, "B S"]) -> Float[Array, "B E"]:
        """Returns the text embedding. Tokens where the mask is False have no influence."""
        return self._pool(self.states(caption_tokens, caption_mask), caption_mask)

    @nn.compact
    def states(self, caption_tokens: Int[Array, "B S"], caption_mask: Bool[Array, "B S"]) -> Float[Array, "B S W"]:
        """Returns the state of each token, which depends on all tokens of its caption."""
        chex.assert_rank(caption_tokens, 2)
        chex.assert_equal_shape([caption_tokens, caption_mask])
        config = self.config
        length = caption_tokens.shape[1]
        if length > config.max_length:
            raise ValueError(f"{length} tokens do not fit a max_length of {config.max_length}")

        def table(name: str, rows: int, width: int) -> Float[Array, "R W"]:
            return jnp.asarray(self.param(name, WEIGHT_INIT, (rows, width)))

        hidden = table("token_embedding", config.vocabulary_size, config.embed_dim)[caption_tokens]
        positions = table("position_embedding", config.num_positions, config.embed_dim)
        hidden += positions[None, config.first_position : config.first_position + length]
        if config.num_types:
            hidden += table("type_embedding", config.num_types, config.embed_dim)[None, :1]
        bias = None
        if config.num_buckets:
            biases = table("distance_bias", config.num_buckets, config.num_heads)
            bias = biases[distance_buckets(length, config.num_buckets)].transpose(2, 0, 1)[None]
        hidden = layer_norm(config.layer_norm_epsilon, "embedding_norm")(hidden)
        for layer in range(config.num_layers):
            hidden = SentenceBlock(config, name=f"block_{layer}")(hidden, caption_mask[:, None, None, :], bias)
        return hidden

    def _pool(self, hidden: Float[Array, "B S W"], mask: Bool[Array, "B S"]) -> Float[Array, "B E"]:
        weights = mask / mask.sum(axis=1, keepdims=True)
        pooled = hidden[:, 0] if self.config.pooling == "cls" else jnp.einsum("bs,bsw->bw", weights, hidden)
        if not self.config.normalize:
            return pooled
        return pooled / jnp.maximum(jnp.linalg.norm(pooled, axis=1, keepdims=True), SHORTEST)
