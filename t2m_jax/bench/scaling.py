"""A model of the published recipes' time on many accelerators: computation, and one all-reduce of the gradients.

The global batch is fixed by the recipe, so each accelerator computes 1 / N of it. The gradients are added up in a ring:
each accelerator sends 2 (N - 1) / N of their bytes to its neighbor, in 2 (N - 1) messages. The model assumes that
nothing of this overlaps with computation, and that a smaller share of the batch is computed at the same rate.

Accelerators with NVLink are in machines of 8. With more of them, the gradients are added up inside each machine, then
each accelerator adds up its eighth of them with its neighbors in the other machines over InfiniBand.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax

from t2m_jax.bench.record import BenchReport
from t2m_jax.bench.train import RECIPE_STEPS, Kind, full_size_rows
from t2m_jax.errors import UserError
from t2m_jax.models.hifigpt import HiFiGptConfig
from t2m_jax.models.motion_gpt import MotionGptConfig
from t2m_jax.models.system import GeneratorConfig, TokenizerConfig, variable_shapes
from t2m_jax.models.vqvae import RvqVaeConfig, VqVaeConfig

COUNTS = (1, 2, 4, 8, 16, 32, 64)
"""Numbers of accelerators."""
PER_MACHINE = 8
"""Accelerators that NVLink connects."""
ASSUMED_SHARE = 0.45
"""Share of a device's peak that an update reaches. This is an assumption for devices that were not measured."""
DEVICES = {"h200": 790e12}
"""Peak of bfloat16 products in FLOP/s: of an H200, measured with large products on a similar machine."""


class Interconnect(NamedTuple):
    """How accelerators are connected."""

    bandwidth: float
    """Bytes/s of one accelerator in one direction."""
    latency: float
    """Seconds of one message. These are typical orders of magnitude, not figures of a vendor."""


INTERCONNECTS = {
    # NVIDIA's data sheets of H100 and H200: 900 GB/s for both directions together.
    "nvlink": Interconnect(450e9, 3e-6),
    # NVIDIA ConnectX-7, NDR: 400 Gbit/s, one adapter for each accelerator.
    "infiniband": Interconnect(50e9, 5e-6),
    # PCI Express 5.0 with 16 lanes: 32 GT/s for each lane (PCI-SIG), with 128b/130b encoding.
    "pcie": Interconnect(63e9, 5e-6),
    # IEEE 802.3: 100 Gbit/s, one port for each accelerator.
    "ethernet": Interconnect(12.5e9, 30e-6),
}
"""Known interconnects by name."""


class Recipe(NamedTuple):
    """A published training."""

    title: str
    flops: float
    """Operations of one update, forward and backward."""
    num_parameters: int
    """Numbers in the gradient, each of 4 bytes."""


class Prediction(NamedTuple):
    """The time of one update on some accelerators."""

    compute: float
    """Seconds."""
    communication: float
    """Seconds."""

    @property
    def total(self) -> float:
        """Seconds of computation and communication."""
        return self.compute + self.communication


def published_recipes() -> dict[Kind, Recipe]:
    """Returns the recipes of both papers for HumanML3D, with the operations that `update_flops` counts for them."""
    return {
        "vqvae": Recipe("VQ-VAE, 256x64", 0.846e12, _num_parameters(VqVaeConfig())),
        "gpt": Recipe("GPT, 128x51", 8.97e12, _num_parameters(MotionGptConfig())),
        "rvqvae": Recipe("RVQ-VAE, 256x32", 0.389e12, _num_parameters(RvqVaeConfig())),
        "hifigpt": Recipe("double-tier GPT, 128x24x10", 5.84e12, _num_parameters(HiFiGptConfig())),
    }


def _num_parameters(config: TokenizerConfig | GeneratorConfig) -> int:
    return sum(math.prod(leaf.shape) for leaf in jax.tree.leaves(variable_shapes(config)["params"]))


def ring_seconds(num_bytes: float, count: int, link: Interconnect) -> float:
    """Returns the time in which the accelerators of a ring add up arrays."""
    num_messages = 2 * (count - 1)
    return num_messages / count * num_bytes / link.bandwidth + num_messages * link.latency


def all_reduce_seconds(num_bytes: float, count: int, interconnect: str) -> float:
    """Returns the time in which accelerators add up arrays.

    Raises:
        UserError: The interconnect is unknown.
    """
    if interconnect not in INTERCONNECTS:
        raise UserError(f"interconnect {interconnect!r} is unknown; known: {', '.join(INTERCONNECTS)}")
    link = INTERCONNECTS[interconnect]
    if interconnect != "nvlink" or count <= PER_MACHINE:
        return ring_seconds(num_bytes, count, link)
    between = ring_seconds(num_bytes / PER_MACHINE, -(-count // PER_MACHINE), INTERCONNECTS["infiniband"])
    return ring_seconds(num_bytes, PER_MACHINE, link) + between


def predict(recipe: Recipe, *, rate: float, count: int, interconnect: str) -> Prediction:
    """Returns the time of an update.

    Args:
        recipe: The training.
        rate: FLOP/s of one accelerator.
        count: Number of accelerators.
        interconnect: Name of their interconnect.
    """
    communication = all_reduce_seconds(4.0 * recipe.num_parameters, count, interconnect)
    return Prediction(recipe.flops / (count * rate), communication)


def assumed_rates(device: str) -> dict[Kind, float]:
    """Returns the FLOP/s of each recipe on a device that was not measured: `ASSUMED_SHARE` of its peak.

    Raises:
        UserError: The device is unknown.
    """
    if device not in DEVICES:
        raise UserError(f"device {device!r} is unknown; known: {', '.join(DEVICES)}")
    return dict.fromkeys(published_recipes(), ASSUMED_SHARE * DEVICES[device])


def measured_rates(report: BenchReport) -> dict[Kind, float]:
    """Returns the FLOP/s of measured recipes on one device, from the fastest row of each at full size on one device.

    Raises:
        UserError: The report has no such row.
    """
    rates: dict[Kind, float] = {}
    for kind in published_recipes():
        rows = [row for row in full_size_rows(report.rows, kind) if "devices" not in row.name]
        if rows:
            rates[kind] = max(row["updates"].value * row["work"].value * 1e12 for row in rows)
    if not rates:
        raise UserError("the report has no training of full size on one device; run `t2m bench train --json FILE`")
    return rates


HEADINGS = ("recipe", "accelerators", "computation, ms", "communication, ms", "300,000 updates, h", "speed-up")
"""Columns of the table."""


def scaling_rows(rates: Mapping[Kind, float], *, interconnect: str, counts: Sequence[int] = COUNTS) -> list[list[str]]:
    """Returns the cells of the table, for each recipe with a rate; communication that takes longer is bold.

    Raises:
        UserError: The interconnect is unknown.
    """
    rows = []
    for kind, recipe in ((kind, recipe) for kind, recipe in published_recipes().items() if kind in rates):
        alone = predict(recipe, rate=rates[kind], count=1, interconnect=interconnect).total
        for count in counts:
            found = predict(recipe, rate=rates[kind], count=count, interconnect=interconnect)
            communication = f"{1e3 * found.communication:.3g}"
            if found.communication > found.compute:
                communication = f"**{communication}**"
            hours, speedup = RECIPE_STEPS * found.total / 3600, alone / found.total
            rows.append(
                [
                    recipe.title,
                    f"{count}",
                    f"{1e3 * found.compute:.3g}",
                    communication,
                    f"{hours:.3g}",
                    f"{speedup:.1f}",
                ]
            )
    return rows
