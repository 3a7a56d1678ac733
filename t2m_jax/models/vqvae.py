"""The motion VQ-VAE of T2M-GPT (arXiv 2301.06052, section 3.1)."""

import dataclasses
import functools
from typing import Any, ClassVar, Literal, NamedTuple

import flax.linen as nn
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.config import check_limits, check_sizes
from t2m_jax.models.convolution import GROUPS, Decoder, Encoder, NormKind, ResidualStack, halve_mask
from t2m_jax.models.quantizer import Quantizer, QuantizerKind
from t2m_jax.models.system import Part

MAX_DILATION = 100_000
"""Largest distance in frames between the taps of a convolution; published models have 9."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class VqVaeConfig:
    """Sizes of the VQ-VAE; the defaults are the published HumanML3D model."""

    kind: ClassVar[str] = "vqvae"
    num_quantizers: ClassVar[int] = 1

    feature_dim: int = 263
    """Features per frame (D)."""
    num_codes: int = 512
    """Codes in the codebook (K)."""
    code_dim: int = 512
    """Width of a code (C)."""
    width: int = 512
    """Channels of the convolutions."""
    num_stages: int = 2
    """How often the encoder halves the length; a code covers 2**num_stages frames."""
    depth: int = 3
    """Residual units in a stack."""
    dilation_growth: int = 3
    """Ratio of the dilations of neighboring units."""
    activation: Literal["relu", "silu", "gelu"] = "relu"
    """Activation inside the residual units."""
    norm: NormKind = "none"
    """Normalization inside the residual units: over channels (LN), 32 groups of channels (GN), or the batch (BN)."""
    quantizer: QuantizerKind = "ema_reset"
    """How the codebook learns: by gradient (`orig`), by running averages, by replacing unused codes, or by both."""
    ema_decay: float = 0.99
    """Share of the old codebook statistics that a step keeps."""
    reset_threshold: float = 1.0
    """A code is replaced if its averaged number of hits per batch is below this."""

    def __post_init__(self) -> None:
        check_sizes(self)
        check_limits(self, feature_dim=65_536, num_codes=1_000_000, code_dim=65_536, width=65_536)
        check_limits(self, num_stages=8, depth=16, dilation_growth=16)
        if self.dilation_growth ** (self.depth - 1) > MAX_DILATION:
            raise ValueError(f"dilation_growth: with depth {self.depth}, convolutions would span {MAX_DILATION} frames")
        if self.norm == "GN" and self.width % GROUPS:
            raise ValueError(f"width: {self.width} is not a multiple of {GROUPS}, which norm GN needs")

    @property
    def downsample(self) -> int:
        """Frames per code."""
        return 2**self.num_stages


class VqVaeOutput(NamedTuple):
    """One pass through the whole VQ-VAE."""

    reconstruction: Float[Array, "B U D"]
    """Normalized motion; U is T rounded down to a multiple of `downsample`."""
    codes: Int[Array, "B N 1"]
    commitment_loss: Float[Array, ""]
    code_counts: Float[Array, " K"]


class VqVae(nn.Module):
    """The tokenizer of T2M-GPT: motion to one code per row, and back.

    Collections: `params`, `codebook` (see `Quantizer`; none with quantizer `orig`), `batch_stats` (with norm `BN`).

    All motion is normalized. `mask` is True where there is data; None means everywhere. Results after the end of a clip
    have no meaning. Results before it do not depend on the values after it.
    """

    config: VqVaeConfig

    def setup(self) -> None:
        """Builds the three parts."""
        config = self.config
        stack = functools.partial(ResidualStack, config.depth, config.dilation_growth, config.activation, config.norm)
        self.encoder = Encoder(config.code_dim, config.width, config.num_stages, stack)
        self.decoder = Decoder(config.feature_dim, config.width, config.num_stages, stack)
        self.quantizer = Quantizer(
            config.num_codes, config.code_dim, config.quantizer, config.ema_decay, config.reset_threshold
        )

    def _latents(
        self, motion: Float[Array, "B T D"], mask: Bool[Array, "B T"] | None, *, train: bool
    ) -> tuple[Float[Array, "B N C"], Bool[Array, "B N"]]:
        if mask is None:
            mask = jnp.ones(motion.shape[:2], bool)
        latents = self.encoder(motion, mask, train=train)
        for _ in range(self.config.num_stages):
            mask = halve_mask(mask)
        return latents, mask

    def __call__(
        self,
        motion: Float[Array, "B T D"],
        mask: Bool[Array, "B T"] | None = None,
        *,
        train: bool,
        noise: Float[Array, "2 K C"] | None = None,
    ) -> VqVaeOutput:
        """Returns the reconstruction, the codes and the commitment loss; moves the codebook if `train`.

        `noise` can be given instead of drawn, see `Quantizer`.
        """
        latents, code_mask = self._latents(motion, mask, train=train)
        output = self.quantizer(latents, code_mask, train=train, noise=noise)
        reconstruction = self.decoder(output.quantized, code_mask, train=train)
        return VqVaeOutput(reconstruction, output.codes[:, :, None], output.commitment_loss, output.code_counts)

    def encode(self, motion: Float[Array, "B T D"], mask: Bool[Array, "B T"] | None = None) -> Int[Array, "B N 1"]:
        """Returns the codes of a motion, 0 after the end of a clip."""
        latents, code_mask = self._latents(motion, mask, train=False)
        codes = self.quantizer(latents, code_mask, train=False).codes
        return jnp.where(code_mask, codes, 0)[:, :, None]

    def encode_latents(
        self, motion: Float[Array, "B T D"], mask: Bool[Array, "B T"] | None = None
    ) -> Float[Array, "B N C"]:
        """Returns the latents before the codebook."""
        return self._latents(motion, mask, train=False)[0]

    def decode(self, codes: Int[Array, "B N *R"], mask: Bool[Array, "B N"] | None = None) -> Float[Array, "B T D"]:
        """Returns the motion of codes, T = N * downsample; `mask` is over codes.

        The axis of the one code per row may be left out.
        """
        return self.decode_latents(self.quantizer.lookup(codes.reshape(codes.shape[:2])), mask)

    def decode_latents(
        self, latents: Float[Array, "B N C"], mask: Bool[Array, "B N"] | None = None
    ) -> Float[Array, "B T D"]:
        """Returns the motion of latents that need not be in the codebook, such as blended codes."""
        if mask is None:
            mask = jnp.ones(latents.shape[:2], bool)
        return self.decoder(latents, mask, train=False)


def _example(config: VqVaeConfig) -> tuple[Any, ...]:
    return (jnp.zeros((1, config.downsample, config.feature_dim)),)


PART = Part(role="tokenizer", config=VqVaeConfig, module=VqVae, example=_example)
"""The entry point `vqvae`."""
