"""The text encoder of CLIP (arXiv 2103.00020, section 2.4). It turns the tokens of a caption into one embedding."""

import dataclasses
from typing import Literal

import chex
import flax.linen as nn
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.field_checks import check_sizes, check_transformer
from t2m_jax.models.projection import WEIGHT_INIT
from t2m_jax.models.transformer import Attention, layer_norm

Activation = Literal["quick_gelu", "gelu"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class ClipTextConfig:
    """Sizes of the text encoder; the defaults are ViT-B/32."""

    vocabulary_size: int = 49408
    """Number of subword tokens, including start and end."""
    max_length: int = 77
    """Longest caption in tokens, including start and end. Longer captions are cut."""
    embed_dim: int = 512
    """Width of the transformer."""
    num_layers: int = 12
    """Number of blocks."""
    num_heads: int = 8
    """Number of attention heads; must divide `embed_dim`."""
    mlp_dim: int = 2048
    """Width of a block's MLP."""
    activation: Activation = "quick_gelu"
    """Activation of the MLP: `quick_gelu` (x times sigmoid of 1.702 x, for OpenAI's weights) or `gelu` (exact)."""
    layer_norm_epsilon: float = 1e-5
    """Number that every layer norm adds to the variance."""
    text_dim: int = 512
    """Width of the text embedding (E)."""
    end_token: int | None = None
    """The embedding is read at the first place of this token. None means the largest token, as in the original.

    Both are the same if End is the last token of the vocabulary. If tokens were added after End, give its number.
    """

    def __post_init__(self) -> None:
        check_sizes(self, *(f.name for f in dataclasses.fields(self) if f.name not in ("end_token", "max_length")))
        check_transformer(self, vocabulary_size=1_000_000, max_length=4096, mlp_dim=65_536, text_dim=65_536)
        if self.max_length < 2:
            raise ValueError(f"max_length: {self.max_length} leaves no room for a start and an end")
        if self.end_token is not None and not 0 <= self.end_token < self.vocabulary_size:
            raise ValueError(f"end_token: {self.end_token} is not one of the {self.vocabulary_size} tokens")


def quick_gelu(values: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Returns OpenAI's approximation of GELU."""
    return values * nn.sigmoid(1.702 * values)


class ClipBlock(nn.Module):
    """Attention and an MLP, each after a layer norm and with a residual connection."""

    config: ClipTextConfig

    @nn.compact
    def __call__(self, hidden: Float[Array, "B S W"], mask: Bool[Array, "1 1 S S"]) -> Float[Array, "B S W"]:
        """Returns the sequence after the block."""
        config = self.config
        attention = Attention(config.num_heads, 0.0, name="attn")
        attended, _ = attention(layer_norm(config.layer_norm_epsilon, "ln1")(hidden), mask, train=False)
        hidden = hidden + attended
        wide = nn.Dense(config.mlp_dim, kernel_init=WEIGHT_INIT, name="up")(
            layer_norm(config.layer_norm_epsilon, "ln2")(hidden)
        )
        wide = quick_gelu(wide) if config.activation == "quick_gelu" else nn.gelu(wide, approximate=False)
        return hidden + nn.Dense(config.embed_dim, kernel_init=WEIGHT_INIT, name="down")(wide)


class ClipText(nn.Module):
    """Reads a caption from start to end and returns its embedding like CLIP's `encode_text`, without normalizing it."""

    config: ClipTextConfig

    @nn.compact
    def __call__(self, caption_tokens: Int[Array, "B S"]) -> Float[Array, "B E"]:
        """Returns the text embedding. Tokens after the end of a caption have no influence."""
        chex.assert_rank(caption_tokens, 2)
        config = self.config
        length = caption_tokens.shape[1]
        if length > config.max_length:
            raise ValueError(f"{length} tokens do not fit a max_length of {config.max_length}")
        positions = self.param("position_embedding", WEIGHT_INIT, (config.max_length, config.embed_dim))
        embed = nn.Embed(config.vocabulary_size, config.embed_dim, embedding_init=WEIGHT_INIT, name="token_embedding")
        hidden = embed(caption_tokens) + positions[None, :length]
        # CLIP was trained with a causal mask, so the end of a caption is the only token that has seen all of it.
        causal = jnp.tril(jnp.ones((1, 1, length, length), bool))
        for layer in range(config.num_layers):
            hidden = ClipBlock(config, name=f"block_{layer}")(hidden, causal)
        # `argmax` returns the first place in both cases, so captions may be padded with End.
        is_end = caption_tokens if config.end_token is None else caption_tokens == config.end_token
        ends = jnp.argmax(is_end, axis=1)
        read = jnp.take_along_axis(hidden, ends[:, None, None], axis=1)[:, 0]
        read = layer_norm(config.layer_norm_epsilon, "final_norm")(read)
        return nn.Dense(config.text_dim, use_bias=False, kernel_init=WEIGHT_INIT, name="projection")(read)
