"""The 1-D convolutional encoder and decoder of T2M-GPT (arXiv 2301.06052, figure 2), masked.

Positions past the end of a clip are set to zero before every convolution. A clip in a padded batch is therefore padded
with the same zeros as it would be alone, and gives the same result.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Literal

import flax.linen as nn
import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from t2m_jax.devices import global_sum
from t2m_jax.models.convolve import convolve, convolve_repeated

ACTIVATIONS: dict[str, Callable[[jax.Array], jax.Array]] = {
    "relu": nn.relu,
    "silu": nn.silu,
    "gelu": lambda values: nn.gelu(values, approximate=False),
}

NormKind = Literal["none", "LN", "GN", "BN"]
Hidden = Float[Array, "B T W"]
"""A sequence between two layers."""
Mask = Bool[Array, "B T"]
GROUPS = 32
"""Number of channel groups of `GN`."""


def normalized(hidden: Hidden, mask: Mask, *, kind: NormKind, name: str, train: bool) -> Hidden:
    """Returns the sequence after a normalization layer called `name`. Call this inside a module's `compact` method.

    `LN` normalizes over the channels of one position. `GN` normalizes over the positions of a clip and the channels of
    a group. `BN` normalizes over the batch and keeps running statistics in the collection `batch_stats`. All of them
    ignore masked positions.
    """
    # The fast variance (mean of squares minus square of the mean) cancels if the mean is large.
    if kind == "LN":
        return nn.LayerNorm(epsilon=1e-5, use_fast_variance=False, name=name)(hidden)
    if kind == "GN":
        norm = nn.GroupNorm(GROUPS, epsilon=1e-6, use_fast_variance=False, name=name)
        return norm(hidden, mask=jnp.broadcast_to(mask[:, :, None], hidden.shape))
    if kind == "BN":
        return MaskedBatchNorm(name=name)(hidden, mask, train=train)
    return hidden


class MaskedBatchNorm(nn.Module):
    """Normalizes over the True positions of the global batch.

    Collection `batch_stats`: running averages `mean` and `var`, which are used if not `train`. `nn.BatchNorm` averages
    the means of the devices, so a device whose clips are short would count too much.
    """

    momentum: float = 0.9
    epsilon: float = 1e-6

    @nn.compact
    def __call__(self, hidden: Hidden, mask: Mask, *, train: bool) -> Hidden:
        """Returns the normalized sequence; statistics are computed in float32."""
        width = hidden.shape[-1:]
        averages = {
            "mean": self.variable("batch_stats", "mean", jnp.zeros, width),
            "var": self.variable("batch_stats", "var", jnp.ones, width),
        }
        scale = self.param("scale", nn.initializers.ones, width)
        bias = self.param("bias", nn.initializers.zeros, width)
        values = hidden.astype(jnp.float32)
        mean = averages["mean"].value
        var = averages["var"].value
        if train:
            mean = _mean_over_positions(values, mask)
            var = _mean_over_positions((values - mean[None, None]) ** 2, mask)
            if not self.is_initializing():  # `init` sees one example of zeros
                for name, now in (("mean", mean), ("var", var)):
                    averages[name].value = self.momentum * averages[name].value + (1 - self.momentum) * now
        normed = (values - mean[None, None]) * (jax.lax.rsqrt(var + self.epsilon) * scale)[None, None]
        return (normed + bias[None, None]).astype(hidden.dtype)


def _mean_over_positions(values: Hidden, mask: Mask) -> Float[Array, " W"]:
    """Returns the mean of each channel over the True positions of the global batch."""
    total, count = global_sum((jnp.sum(jnp.where(mask[:, :, None], values, 0.0), axis=(0, 1)), jnp.sum(mask)))
    return total / jnp.maximum(count, 1)


def uniform_init(bound: float) -> nn.initializers.Initializer:
    """Returns an initializer that draws from -bound to bound."""

    def initialize(key: PRNGKeyArray, shape: Sequence[int], dtype: DTypeLike = jnp.float32) -> jax.Array:
        return jax.random.uniform(key, shape, dtype, -bound, bound)

    return initialize


def halve_mask(mask: Mask) -> Bool[Array, "B T//2"]:
    """Returns the mask after a stride of 2. A clip of length t keeps t // 2 positions."""
    return mask[:, 1::2]


class Conv(nn.Module):
    """The parameters of a 1-D convolution, as in `nn.Conv`, applied in the dtype of the inputs."""

    features: int
    kernel_size: int

    @nn.compact
    def __call__(self, inputs: Float[Array, "B T X"], form: Callable[..., jax.Array]) -> Float[Array, "B U Y"]:
        """Returns `form(inputs, kernel)` plus the bias."""
        # PyTorch's default for kernels and biases, which the original uses.
        initializer = uniform_init((self.kernel_size * inputs.shape[-1]) ** -0.5)
        kernel = self.param("kernel", initializer, (self.kernel_size, inputs.shape[-1], self.features))
        bias = self.param("bias", initializer, (self.features,))
        kernel, bias = (jnp.asarray(values, inputs.dtype) for values in (kernel, bias))
        return form(inputs, kernel) + bias[None, None]


class MaskedConv(nn.Module):
    """A 1-D convolution that reads zeros where `mask` is False."""

    features: int
    kernel_size: int
    stride: int = 1
    dilation: int = 1
    padding: int = 0

    @nn.compact
    def __call__(self, inputs: Float[Array, "B T X"], mask: Mask) -> Float[Array, "B U Y"]:
        """Returns the convolved sequence of `U = T // stride` positions."""
        form = functools.partial(convolve, stride=self.stride, dilation=self.dilation, padding=self.padding)
        return Conv(self.features, self.kernel_size, name="conv")(jnp.where(mask[:, :, None], inputs, 0.0), form)


class MaskedUpConv(nn.Module):
    """Repeats every position, then applies a convolution of width 3 that reads zeros where `mask` is False."""

    features: int

    @nn.compact
    def __call__(self, inputs: Float[Array, "B N X"], mask: Bool[Array, "B N"]) -> Float[Array, "B 2*N Y"]:
        """Returns the longer sequence."""
        return Conv(self.features, 3, name="conv")(jnp.where(mask[:, :, None], inputs, 0.0), convolve_repeated)


class ResidualUnit(nn.Module):
    """A pre-activation residual unit: a dilated convolution of width 3, then one of width 1, each after its norm."""

    dilation: int
    activation: str
    norm: NormKind

    @nn.compact
    def __call__(self, inputs: Hidden, mask: Mask, *, train: bool) -> Hidden:
        """Returns the inputs plus the output of the convolutions."""
        width = inputs.shape[-1]
        activation = ACTIVATIONS[self.activation]
        branch = activation(normalized(inputs, mask, kind=self.norm, name="norm1", train=train))
        branch = MaskedConv(width, 3, dilation=self.dilation, padding=self.dilation, name="dilated")(branch, mask)
        branch = activation(normalized(branch, mask, kind=self.norm, name="norm2", train=train))
        return inputs + MaskedConv(width, 1, name="pointwise")(branch, mask)


class ResidualStack(nn.Module):
    """Residual units from the largest dilation to the smallest. The original reverses the order in both halves."""

    depth: int
    dilation_growth: int
    activation: str
    norm: NormKind

    @nn.compact
    def __call__(self, hidden: Hidden, mask: Mask, *, train: bool) -> Hidden:
        """Returns the sequence after all units."""
        for unit in range(self.depth):
            dilation = self.dilation_growth ** (self.depth - 1 - unit)
            hidden = ResidualUnit(dilation, self.activation, self.norm, name=f"unit_{unit}")(hidden, mask, train=train)
        return hidden


class Encoder(nn.Module):
    """Turns motion into latents by `num_stages` halvings in time, each followed by a residual stack."""

    code_dim: int
    width: int
    num_stages: int
    stack: Callable[..., ResidualStack]
    """Makes the residual stack of a stage. It gets the `name`."""

    @nn.compact
    def __call__(self, motion: Float[Array, "B T D"], mask: Mask, *, train: bool) -> Float[Array, "B N C"]:
        """Returns latents. N is T halved `num_stages` times and rounded down."""
        hidden = nn.relu(MaskedConv(self.width, 3, padding=1, name="input")(motion, mask))
        for stage in range(self.num_stages):
            # A kernel of twice the stride: every frame counts in two positions.
            hidden = MaskedConv(self.width, 4, stride=2, padding=1, name=f"down_{stage}")(hidden, mask)
            mask = halve_mask(mask)
            hidden = self.stack(name=f"stack_{stage}")(hidden, mask, train=train)
        return MaskedConv(self.code_dim, 3, padding=1, name="output")(hidden, mask)


class Decoder(nn.Module):
    """Turns latents into motion by `num_stages` residual stacks, each followed by a doubling in time."""

    feature_dim: int
    width: int
    num_stages: int
    stack: Callable[..., ResidualStack]
    """Makes the residual stack of a stage. It gets the `name`."""

    @nn.compact
    def __call__(
        self, latents: Float[Array, "B N C"], mask: Bool[Array, "B N"], *, train: bool
    ) -> Float[Array, "B T D"]:
        """Returns motion of T = N * 2**num_stages frames."""
        hidden = nn.relu(MaskedConv(self.width, 3, padding=1, name="input")(latents, mask))
        for stage in range(self.num_stages):
            hidden = self.stack(name=f"stack_{stage}")(hidden, mask, train=train)
            hidden = MaskedUpConv(self.width, name=f"up_{stage}")(hidden, mask)
            mask = jnp.repeat(mask, 2, axis=1)
        hidden = nn.relu(MaskedConv(self.width, 3, padding=1, name="penultimate")(hidden, mask))
        return MaskedConv(self.feature_dim, 3, padding=1, name="output")(hidden, mask)
