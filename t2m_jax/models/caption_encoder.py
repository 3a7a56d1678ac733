"""A small transformer that turns a caption into one text embedding.

It reads subword tokens through a table of its own, or the token states of a sentence encoder, which is not trained.
"""

import dataclasses
from typing import Any, ClassVar

import chex
import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from t2m_jax.field_checks import check_shares, check_sizes, check_transformer
from t2m_jax.models.projection import WEIGHT_INIT
from t2m_jax.models.transformer import LAYER_NORM_EPSILON, Block

POSITION_INIT = nn.initializers.normal(0.5)
"""Of positions, which are added to states of unit variance. With the usual 0.02, the order of two actions was read
less often: in 35 and not 52 % of sentences with new pairs of actions, after 1,000 updates."""


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
        check_transformer(self, vocabulary_size=1_000_000, max_length=4096, mlp_ratio=64, text_dim=65_536)
        check_shares(self, "dropout", with_one=False)


@dataclasses.dataclass(frozen=True, kw_only=True)
class StateEncoderConfig:
    """Sizes of the network that reads the token states of a sentence encoder."""

    kind: ClassVar[str] = "state_encoder"

    state_dim: int = 384
    """Width of the states. Training takes it from the sentence encoder."""
    max_length: int = 64
    """Longest caption in tokens, including special ones. Longer captions are cut."""
    embed_dim: int = 192
    """Width of the transformer."""
    num_layers: int = 2
    """Number of blocks."""
    num_heads: int = 4
    """Number of attention heads; must divide `embed_dim`."""
    mlp_ratio: int = 4
    """Width of a block's MLP divided by `embed_dim`."""
    dropout: float = 0.1
    """Dropout rate in the attention and the MLP."""
    token_dropout: float = 0.05
    """Probability with which a token is hidden in training. The first one, which stands for the sentence, is not."""
    text_dim: int = 256
    """Width of the text embedding (E)."""

    def __post_init__(self) -> None:
        check_sizes(self)
        check_transformer(self, state_dim=16_384, max_length=4096, mlp_ratio=64, text_dim=65_536)
        check_shares(self, "dropout", "token_dropout", with_one=False)


NetworkConfig = CaptionEncoderConfig | StateEncoderConfig


def embed_hidden(
    config: NetworkConfig, hidden: Float[Array, "B S W"], mask: Bool[Array, "B S"], *, train: bool
) -> Float[Array, "B E"]:
    """Returns the text embedding of tokens with their positions. Its layers belong to the module that calls it."""
    for layer in range(config.num_layers):
        block = Block(config.num_heads, config.mlp_ratio, config.dropout, name=f"block_{layer}")
        hidden, _ = block(hidden, mask[:, None, None, :], train=train)
    hidden = nn.LayerNorm(epsilon=LAYER_NORM_EPSILON, name="final_norm")(hidden)
    weights = mask / mask.sum(axis=1, keepdims=True)
    pooled = jnp.einsum("bs,bsw->bw", weights.astype(hidden.dtype), hidden)
    return nn.Dense(config.text_dim, kernel_init=WEIGHT_INIT, name="projection")(pooled)


class CaptionEncoder(nn.Module):
    """Reads the subwords of a whole caption and returns its embedding. Training uses the RNG stream `dropout`."""

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
        return embed_hidden(config, hidden, caption_mask, train=train)


class StateEncoder(nn.Module):
    """Reads the token states of a caption and returns its embedding. Training uses the RNG stream `dropout`."""

    config: StateEncoderConfig

    @nn.compact
    def __call__(
        self, states: Float[Array, "B S C"], state_mask: Bool[Array, "B S"], *, train: bool
    ) -> Float[Array, "B E"]:
        """Returns the text embedding. States where the mask is False have no influence."""
        config = self.config
        chex.assert_shape(states, (*state_mask.shape, config.state_dim))
        positions = self.param("position_embedding", POSITION_INIT, (config.max_length, config.embed_dim))
        hidden = nn.LayerNorm(epsilon=LAYER_NORM_EPSILON, name="state_norm")(states)
        hidden = nn.Dense(config.embed_dim, kernel_init=nn.initializers.lecun_normal(), name="reduce")(hidden)
        hidden += positions[None, : states.shape[1]]
        if train and config.token_dropout:
            kept = jax.random.bernoulli(self.make_rng("dropout"), 1 - config.token_dropout, state_mask.shape)
            # Attention to no token at all would be NaN.
            state_mask &= kept.at[:, 0].set(True)
        return embed_hidden(config, hidden, state_mask, train=train)


def network_module(config: NetworkConfig) -> CaptionEncoder | StateEncoder:
    """Returns the module of a config."""
    return StateEncoder(config) if isinstance(config, StateEncoderConfig) else CaptionEncoder(config)


def init_network(config: NetworkConfig, key: Key[Array, ""]) -> dict[str, Any]:
    """Returns the first variables of a network; `key` is consumed."""
    mask = jnp.ones((1, config.max_length), bool)
    # Tokens, or their states.
    inputs = jnp.zeros((*mask.shape, config.state_dim)) if isinstance(config, StateEncoderConfig) else mask.astype(int)
    return network_module(config).init(key, inputs, mask, train=False)
