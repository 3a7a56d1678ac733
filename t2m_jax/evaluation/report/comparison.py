"""A paired test of two reports: are their differences more than chance?"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError, printable
from t2m_jax.evaluation.report.record import COMPARABLE, Report, first_difference
from t2m_jax.files.markdown import markdown_table

PAIRED = (*COMPARABLE, "unit")
"""Fields of the header that two reports must share, so that their repeats use the same pieces of the same motions."""
MAX_EXACT = 16
"""Repeats up to which all signs are tried. With more repeats, 2**16 sets of signs are drawn."""


class Difference(NamedTuple):
    """The second report minus the first, in one metric of the measured motion."""

    metric: str
    first: float
    second: float
    interval: float
    """Half-width of the 95 % interval of the mean difference."""
    p_value: float
    """Probability of a mean difference as large as this, if the reports could be exchanged in each repeat."""


def sign_test(differences: Float[np.ndarray, " R"]) -> float:
    """Returns the two-sided p-value of the paired permutation test, in which each difference may change its sign."""
    count = len(differences)
    if count <= MAX_EXACT:
        # The bits of each number up to 2**count are one way to exchange the reports in some repeats.
        signs = 1 - 2 * ((np.arange(2**count)[:, None] >> np.arange(count)) & 1)
    else:
        # A fixed seed, so that two reports always have the same p-value.
        signs = np.random.default_rng(0).choice([-1, 1], size=(2**MAX_EXACT, count))
        signs[0] = 1  # so that the observed sum counts, and the p-value is not 0
    sums = np.abs(signs @ differences)
    # The factor keeps sums that are equal but for rounding.
    return float(np.mean(sums >= np.abs(differences.sum()) * (1 - 1e-9)))


def compare_reports(first: Report, second: Report) -> list[Difference]:
    """Returns the differences of two reports in every metric that both have.

    Raises:
        UserError: Their repeats do not belong together.
    """
    if difference := first_difference(first.header, second.header, PAIRED):
        name, one, other = difference
        raise UserError(f"{name}: {one} in one report, {other} in the other; evaluate both in the same way")
    found = []
    for metric in (name for name in first.measured if name in second.measured):
        one, other = (np.asarray(report.measured[metric].repeats) for report in (first, second))
        if len(one) != len(other) or len(one) < 2:
            raise UserError(
                f"repeats: {len(one)} in one report, {len(other)} in the other; give both the same number, at least 2"
            )
        # Repeat k of both uses the same pieces of the same motions, so their difference has less noise than either.
        differences = other - one
        # Unbiased, unlike the intervals of tables, which are those of the published codes.
        interval = 1.96 * differences.std(ddof=1) / np.sqrt(len(differences))
        found.append(Difference(metric, one.mean(), other.mean(), interval, sign_test(differences)))
    return found


def comparison_table(names: Sequence[str], differences: Sequence[Difference]) -> str:
    """Returns the Markdown table of a comparison; differences with p < 0.05 are bold."""
    lines = []
    for found in differences:
        change = f"{found.second - found.first:+.3f} ± {found.interval:.3f}"
        change = f"**{change}**" if found.p_value < 0.05 else change
        p_value = f"{found.p_value:.4f}" if found.p_value >= 1e-4 else "< 0.0001"
        lines.append((found.metric, f"{found.first:.3f}", f"{found.second:.3f}", change, p_value))
    return markdown_table(("metric", *map(printable, names), "difference", "p"), lines)
