"""Pre-norm transformer blocks of the motion GPT (causal, cached) and the caption encoder (bidirectional)."""

from collections.abc import Sequence
from typing import NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.models.projection import Projection

LAYER_NORM_EPSILON = 1e-5


class LayerCache(NamedTuple):
    """Keys and values of the positions that one attention layer has read; other positions are zero."""

    keys: Float[Array, "B H L F"]
    values: Float[Array, "B H L F"]


def layer_norm(epsilon: float, name: str) -> nn.LayerNorm:
    """Returns a layer norm of a pretrained encoder, with the slow variance.

    The fast one is not exact where the mean is far from zero, as that of CLIP's activations.
    """
    return nn.LayerNorm(epsilon=epsilon, use_fast_variance=False, name=name)


def empty_cache(batch: int, length: int, *, embed_dim: int, num_heads: int) -> LayerCache:
    """Returns an empty cache for `length` positions."""
    zeros = jnp.zeros((batch, num_heads, length, embed_dim // num_heads))
    return LayerCache(zeros, zeros)


class Attention(nn.Module):
    """Multi-head self-attention."""

    num_heads: int
    dropout: float

    @nn.compact
    def __call__(
        self,
        hidden: Float[Array, "B L E"],
        mask: Bool[Array, "#B 1 #L S"],
        *,
        train: bool,
        cache: LayerCache | None = None,
        position: Int[Array, ""] | None = None,
        bias: Float[Array, "1 H L S"] | None = None,
    ) -> tuple[Float[Array, "B L E"], LayerCache | None]:
        """Returns the sequence after attention and, if a cache is given, the cache with this step at `position`.

        A `bias` is added to the scores of all sequences.
        """
        embed_dim = hidden.shape[-1]

        def project(name: str) -> Float[Array, "B H L F"]:
            projected = Projection(embed_dim, name=name)(hidden)
            return projected.reshape(*hidden.shape[:2], self.num_heads, -1).transpose(0, 2, 1, 3)

        queries = project("query")
        keys = project("key")
        values = project("value")
        if cache is not None:
            assert position is not None, "a cached step needs its position"
            keys = jax.lax.dynamic_update_slice_in_dim(cache.keys, keys, position, axis=2)
            values = jax.lax.dynamic_update_slice_in_dim(cache.values, values, position, axis=2)
            cache = LayerCache(keys, values)
        # A softmax in 16 bits would lose small weights.
        scores = jnp.einsum("bhqf,bhkf->bhqk", queries, keys, preferred_element_type=jnp.float32)
        scores *= queries.shape[-1] ** -0.5
        scores = scores if bias is None else scores + bias
        weights = nn.softmax(jnp.where(mask, scores, -jnp.inf)).astype(hidden.dtype)
        weights = nn.Dropout(self.dropout)(weights, deterministic=not train)
        attended = jnp.einsum("bhqk,bhkf->bhqf", weights, values).transpose(0, 2, 1, 3).reshape(hidden.shape)
        output = Projection(embed_dim, name="proj")(attended)
        return nn.Dropout(self.dropout)(output, deterministic=not train), cache


class Mlp(nn.Module):
    """Two layers with an exact GELU between them."""

    ratio: int
    dropout: float

    @nn.compact
    def __call__(self, hidden: Float[Array, "B L E"], *, train: bool) -> Float[Array, "B L E"]:
        """Returns the transformed sequence."""
        embed_dim = hidden.shape[-1]
        hidden = Projection(self.ratio * embed_dim, name="up")(hidden)
        hidden = nn.gelu(hidden, approximate=False)
        hidden = Projection(embed_dim, name="down")(hidden)
        return nn.Dropout(self.dropout)(hidden, deterministic=not train)


class Block(nn.Module):
    """Attention and an MLP, each after a layer norm and with a residual connection."""

    num_heads: int
    mlp_ratio: int
    dropout: float

    @nn.compact
    def __call__(
        self,
        hidden: Float[Array, "B L E"],
        mask: Bool[Array, "#B 1 #L S"],
        *,
        train: bool,
        cache: LayerCache | None = None,
        position: Int[Array, ""] | None = None,
    ) -> tuple[Float[Array, "B L E"], LayerCache | None]:
        """Returns the sequence after the block and the updated cache, if one was given."""
        normed = nn.LayerNorm(epsilon=LAYER_NORM_EPSILON, name="ln1")(hidden)
        attention = Attention(self.num_heads, self.dropout, name="attn")
        attended, cache = attention(normed, mask, train=train, cache=cache, position=position)
        hidden = hidden + attended
        normed = nn.LayerNorm(epsilon=LAYER_NORM_EPSILON, name="ln2")(hidden)
        return hidden + Mlp(self.mlp_ratio, self.dropout, name="mlp")(normed, train=train), cache


def read_causal(
    blocks: Sequence[Block], hidden: Float[Array, "B L E"], *, train: bool, remat: bool
) -> Float[Array, "B L E"]:
    """Returns a sequence after all blocks, in which no position sees a later one.

    With `remat`, the intermediate values of a block are computed again for the gradient.
    """
    # The mask is a constant of the program, since all sequences have the length of the batch.
    causal = jnp.tril(jnp.ones((1, 1, hidden.shape[1], hidden.shape[1]), bool))

    def read(block: Block, hidden: Float[Array, "B L E"]) -> Float[Array, "B L E"]:
        return block(hidden, causal, train=train)[0]

    for block in blocks:
        hidden = (nn.remat(read) if remat else read)(block, hidden)
    return hidden


def read_one(
    blocks: Sequence[Block], inputs: Float[Array, "B E"], layers: Sequence[LayerCache], position: Int[Array, ""]
) -> tuple[Float[Array, "B E"], tuple[LayerCache, ...]]:
    """Returns the output of all blocks for one more input at `position`, and their caches with it."""
    hidden = inputs[:, None]
    # The cache has room for all positions. Those after this one are zeros, and must not count.
    seen = (jnp.arange(layers[0].keys.shape[2]) <= position)[None, None, None, :]
    filled = []
    for block, layer in zip(blocks, layers, strict=True):
        hidden, layer = block(hidden, seen, train=False, cache=layer, position=position)
        filled.append(layer)
    return hidden[:, 0], tuple(filled)
