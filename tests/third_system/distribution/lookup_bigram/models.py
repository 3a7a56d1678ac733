"""A tokenizer that looks up the mean pose of eight frames, twice, and a prior over pairs of consecutive rows."""

import dataclasses
from typing import ClassVar

import flax.linen as nn
import jax.numpy as jnp

from t2m_jax.models.system import Part, draw_each, keys_of_depths, log_probabilities


@dataclasses.dataclass(frozen=True, kw_only=True)
class LookupConfig:
    """Sizes of the tokenizer."""

    kind: ClassVar[str] = "lookup"
    num_quantizers: ClassVar[int] = 2
    decoder_context: ClassVar[int] = 0

    feature_dim: int = 263
    """Features per frame."""
    num_codes: int = 8
    """Poses in the codebook."""
    downsample: int = 8
    """Frames per row."""


class Lookup(nn.Module):
    """Codes of a row: the pose nearest to the mean of its frames, then the pose nearest to what is left."""

    config: LookupConfig

    def setup(self):
        shape = (self.config.num_codes, self.config.feature_dim)
        self.codebook = self.param("codebook", nn.initializers.normal(1.0), shape)

    def __call__(self, motion, mask=None, *, train):
        """Returns the reconstruction and the codes."""
        codes = self.encode(motion, mask)
        return self.decode(codes), codes

    def encode(self, motion, mask=None):
        """Returns the codes, 0 after the end."""
        size, frames, width = motion.shape
        rows = frames // self.config.downsample
        pooled = motion[:, : rows * self.config.downsample].reshape(size, rows, -1, width).mean(2)
        codes = []
        for _ in range(self.config.num_quantizers):
            squares = jnp.sum((pooled[:, :, None] - self.codebook[None, None]) ** 2, axis=-1)
            codes.append(jnp.argmin(squares, axis=-1).astype(jnp.int32))
            pooled = pooled - self.codebook[codes[-1]]
        codes = jnp.stack(codes, axis=-1)
        if mask is None:
            return codes
        kept = mask[:, self.config.downsample - 1 :: self.config.downsample][:, :rows]
        return jnp.where(kept[:, :, None], codes, 0)

    def decode(self, codes, mask=None):
        """Returns the sum of the looked-up poses for each frame of a row."""
        return jnp.repeat(self.codebook[codes].sum(2), self.config.downsample, axis=1)


@dataclasses.dataclass(frozen=True, kw_only=True)
class BigramConfig:
    """Sizes of the prior."""

    kind: ClassVar[str] = "bigram"
    num_quantizers: ClassVar[int] = 2
    stop_rule: ClassVar[str] = "threshold"
    guidance_scale: ClassVar[None] = None

    num_codes: int = 8
    """Poses in the tokenizer's codebook."""
    text_dim: int = 12
    """Width of the text embedding."""
    max_codes: int = 24
    """Rows of the longest motion."""


class Bigram(nn.Module):
    """Predicts a row from the row before and the text; the first row follows an imaginary row."""

    config: BigramConfig

    def setup(self):
        config, normal = self.config, nn.initializers.normal(1.0)
        self.table = self.param("table", normal, (config.num_codes + 1, config.num_quantizers, config.num_codes))
        self.stop = self.param("stop", normal, (config.num_codes,))
        self.text = nn.Dense(config.num_quantizers * config.num_codes)

    def __call__(self, rows, text_embedding, *, train):
        """Returns the logits of each row [B, N, R, K] and the stop logit of each row [B, N]."""
        start = jnp.full((rows.shape[0], 1), self.config.num_codes, jnp.int32)
        before = jnp.concatenate([start, rows[:, :-1, 0]], axis=1)
        return self._logits(before, self._bias(text_embedding)[:, None]), self.stop[rows[:, :, 0]]

    def _bias(self, text_embedding):
        return self.text(text_embedding).reshape(-1, self.config.num_quantizers, self.config.num_codes)

    def _logits(self, before, bias):
        return self.table[before] + bias

    def begin(self, text_embedding, guidance_scale=None):
        """Returns the logits of the first row; the text is the cache. Guidance makes the text weigh more."""
        bias = self._bias(text_embedding) * (1.0 if guidance_scale is None else guidance_scale)
        return self._logits(jnp.full(len(bias), self.config.num_codes), bias), bias

    def draw(self, context, keys, strategy, *, may_stop):
        """Returns one code for each depth."""
        keys = keys_of_depths(keys, self.config.num_quantizers)
        depths = range(self.config.num_quantizers)
        return jnp.stack([draw_each(strategy, context[:, depth], keys[:, depth]) for depth in depths], axis=1)

    def step(self, cache, rows):
        """Returns the logits of the next row, the stop logit of this one, and the text."""
        return self._logits(rows[:, 0], cache), self.stop[rows[:, 0]], cache

    def log_likelihood(self, codes, text_embedding):
        """Returns the logarithm of the probability of each row."""
        return log_probabilities(self(codes, text_embedding, train=False)[0], codes).sum(axis=-1)


TOKENIZER = Part(
    role="tokenizer",
    config=LookupConfig,
    module=Lookup,
    example=lambda config: (jnp.zeros((1, config.downsample, config.feature_dim)),),
)
GENERATOR = Part(
    role="generator",
    config=BigramConfig,
    module=Bigram,
    example=lambda config: (jnp.zeros((1, 1, config.num_quantizers), jnp.int32), jnp.zeros((1, config.text_dim))),
)
