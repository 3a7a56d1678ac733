"""The motion VQ-VAE of T2M-GPT (arXiv 2301.06052, section 3.1), and the residual one of T2M-HiFiGPT (arXiv 2312.10628).

They are one module: the second has several codes per row, which add up.
"""

import dataclasses
import functools
from typing import Any, ClassVar, Literal, NamedTuple

import chex
import flax.linen as nn
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.field_checks import check_limits, check_shares, check_sizes
from t2m_jax.models.codebook import QuantizerKind
from t2m_jax.models.convolution import GROUPS, Decoder, Encoder, NormKind, ResidualStack, halve_mask
from t2m_jax.models.quantizer import CodebookUpdate, CommitmentKind, Quantizer
from t2m_jax.models.system import Part

DECODER_PARTS = ("decoder", "project_out")
"""The parameters that read codes."""
MAX_DILATION = 100_000
"""Largest distance in frames between the taps of a convolution; published models have 9."""

MAX_ROWS = 1_000_000
"""More rows than any motion has."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class VqVaeConfig:
    """Sizes of the VQ-VAE; the defaults are the published HumanML3D model."""

    kind: ClassVar[str] = "vqvae"

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
    """How the codebook learns: by gradient (`orig`), by running averages, by replacing unused codes, or by both;
    `ema_redraw` draws the new codes from the whole batch (T2M-HiFiGPT)."""
    ema_decay: float = 0.99
    """Share of the old codebook statistics that a step keeps."""
    reset_threshold: float = 1.0
    """A code is replaced if its averaged number of hits per batch is below this."""
    num_quantizers: int = 1
    """Codes per row (R), which add up: each is nearest to what the ones before it leave. All share the codebook."""
    projections: bool = False
    """Whether a linear layer stands before the codebook and another after it."""
    codebook_update: CodebookUpdate = "joint"
    """When the codebook moves in a step: once after all depths (`joint`), or after each depth (`per_depth`). Public
    RQ-VAE code does the second. The next depth then reads other codes than in evaluation."""
    commitment: CommitmentKind = "mean"
    """Commitment loss over the depths: their mean or their sum."""
    depth_dropout: float = 0.0
    """Probability that a training step uses only some of the first depths; their number is drawn."""

    def __post_init__(self) -> None:
        check_sizes(self)
        check_limits(self, feature_dim=65_536, num_codes=1_000_000, code_dim=65_536, width=65_536)
        check_limits(self, num_stages=8, depth=16, dilation_growth=16, num_quantizers=64)
        check_shares(self, "ema_decay", "depth_dropout")
        if self.dilation_growth ** (self.depth - 1) > MAX_DILATION:
            raise ValueError(f"dilation_growth: with depth {self.depth}, convolutions would span {MAX_DILATION} frames")
        if self.norm == "GN" and self.width % GROUPS:
            raise ValueError(f"width: {self.width} is not a multiple of {GROUPS}, which norm GN needs")
        if self.codebook_update == "per_depth" and self.quantizer not in ("ema", "ema_redraw"):
            raise ValueError(f"codebook_update: per_depth needs quantizer ema or ema_redraw, not {self.quantizer}")
        if self.quantizer == "ema_redraw" and not 0 <= self.reset_threshold <= 1:
            raise ValueError(f"reset_threshold: {self.reset_threshold} is not between 0 and 1, as ema_redraw needs")

    @property
    def downsample(self) -> int:
        """Frames per code."""
        return 2**self.num_stages

    @property
    def decoder_context(self) -> int:
        """Rows after a row that its frames depend on."""
        if self.norm == "GN":
            return MAX_ROWS  # it normalizes over all of a motion
        reach = 2  # in positions: the last two convolutions
        for _ in range(self.num_stages):
            # The convolution after a doubling; then, with half as many positions, the stack.
            reach = -(-(reach + 1) // 2) + sum(self.dilation_growth**unit for unit in range(self.depth))
        return reach + 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class RvqVaeConfig(VqVaeConfig):
    """Sizes of the residual VQ-VAE of T2M-HiFiGPT; the defaults are its paper's (see `docs/hifigpt.md`)."""

    kind: ClassVar[str] = "rvqvae"

    num_codes: int = 256
    num_stages: int = 3
    depth: int = 2
    quantizer: QuantizerKind = "ema_redraw"
    num_quantizers: int = 10
    projections: bool = True


class VqVaeOutput(NamedTuple):
    """One pass through the whole VQ-VAE."""

    reconstruction: Float[Array, "B U D"]
    """Normalized motion; U is T rounded down to a multiple of `downsample`."""
    codes: Int[Array, "B N R"]
    commitment_loss: Float[Array, ""]
    code_counts: Float[Array, "R K"]
    residual_norms: Float[Array, " R"]
    expired: Float[Array, " R"]


class VqVae(nn.Module):
    """The tokenizer: motion to R codes per row, and back. R is 1 in T2M-GPT.

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
            config.num_codes,
            config.code_dim,
            config.quantizer,
            config.ema_decay,
            config.reset_threshold,
            config.num_quantizers,
            config.codebook_update,
            config.commitment,
            config.depth_dropout,
        )
        if config.projections:
            self.project_in = nn.Dense(config.code_dim)
            self.project_out = nn.Dense(config.code_dim)

    def _latents(
        self, motion: Float[Array, "B T D"], mask: Bool[Array, "B T"] | None, *, train: bool
    ) -> tuple[Float[Array, "B N C"], Bool[Array, "B N"]]:
        chex.assert_shape(motion, (None, None, self.config.feature_dim))
        if mask is None:
            mask = jnp.ones(motion.shape[:2], bool)
        chex.assert_shape(mask, motion.shape[:2])
        latents = self.encoder(motion, mask, train=train)
        if self.config.projections:
            latents = self.project_in(latents)
        for _ in range(self.config.num_stages):
            mask = halve_mask(mask)
        return latents, mask

    def __call__(
        self, motion: Float[Array, "B T D"], mask: Bool[Array, "B T"] | None = None, *, train: bool
    ) -> VqVaeOutput:
        """Returns the reconstruction, the codes and the commitment loss; moves the codebook if `train`."""
        latents, code_mask = self._latents(motion, mask, train=train)
        output = self.quantizer(latents, code_mask, train=train)
        reconstruction = self._decode(output.quantized, code_mask, train=train)
        return VqVaeOutput(reconstruction, *output[1:])

    def _decode(
        self, latents: Float[Array, "B N C"], mask: Bool[Array, "B N"], *, train: bool
    ) -> Float[Array, "B U D"]:
        if self.config.projections:
            latents = self.project_out(latents)
        return self.decoder(latents, mask, train=train)

    def encode(self, motion: Float[Array, "B T D"], mask: Bool[Array, "B T"] | None = None) -> Int[Array, "B N R"]:
        """Returns the codes of a motion, 0 after the end of a clip."""
        latents, code_mask = self._latents(motion, mask, train=False)
        codes = self.quantizer(latents, code_mask, train=False).codes
        # Any code would do after the end; a fixed one makes results equal to the last bit.
        return jnp.where(code_mask[:, :, None], codes, 0)

    def decode(self, codes: Int[Array, "B N *R"], mask: Bool[Array, "B N"] | None = None) -> Float[Array, "B T D"]:
        """Returns the motion of codes, T = N * downsample; `mask` is over codes.

        With fewer codes per row than `num_quantizers`, those of the first depths, the motion is coarser. The last axis
        may be left out if there is one code per row.
        """
        depth = self.config.num_quantizers
        # Codes without the last axis are the only depth there is. Of several depths, one might be meant for all.
        chex.assert_rank(codes, {2, 3} if depth == 1 else 3)
        rows = codes.reshape(*codes.shape[:2], -1)
        chex.assert_axis_dimension_lteq(rows, 2, depth)
        return self.decode_latents(self.latents_of(rows), mask)

    def latents_of(self, codes: Int[Array, "B N R"]) -> Float[Array, "B N C"]:
        """Returns the latents of codes, from which `decode_latents` makes their motion."""
        return self.quantizer.lookup(codes)

    def read_codebook(self) -> Float[Array, "K C"]:
        """Returns the codebook."""
        return self.quantizer.read_codebook()

    def decode_latents(
        self, latents: Float[Array, "B N C"], mask: Bool[Array, "B N"] | None = None
    ) -> Float[Array, "B T D"]:
        """Returns the motion of latents that need not be in the codebook, such as blended codes."""
        chex.assert_shape(latents, (None, None, self.config.code_dim))
        if mask is None:
            mask = jnp.ones(latents.shape[:2], bool)
        chex.assert_shape(mask, latents.shape[:2])
        return self._decode(latents, mask, train=False)


def _example(config: VqVaeConfig) -> tuple[Any, ...]:
    return (jnp.zeros((1, config.downsample, config.feature_dim)),)


def _codebook(config: VqVaeConfig, variables: Any) -> Float[Array, "K C"]:
    return VqVae(config).apply(variables, method="read_codebook")


PART = Part(role="tokenizer", config=VqVaeConfig, module=VqVae, example=_example, codebook=_codebook, has_latents=True)
"""The entry point `vqvae`."""
RESIDUAL_PART = Part(
    role="tokenizer", config=RvqVaeConfig, module=VqVae, example=_example, codebook=_codebook, has_latents=True
)
"""The entry point `rvqvae`."""
