"""Two reports of one protocol, metric by metric: are their differences more than chance?"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.evaluation.report.record import SAME

MAX_EXACT = 16
"""Repeats up to which all signs are tried; with more, as many are drawn."""


class Difference(NamedTuple):
    """The second report less the first, in one metric of what was generated or reconstructed."""

    metric: str
    first: float
    second: float
    interval: float
    """Half-width of the 95 % interval of the mean difference."""
    p_value: float
    """Chance of a mean difference as large if the reports could be exchanged repeat by repeat."""


def sign_test(differences: Float[np.ndarray, " R"]) -> float:
    """Returns the two-sided p-value of the paired permutation test: each difference may as well have the other sign."""
    count = len(differences)
    if count <= MAX_EXACT:
        signs = 1 - 2 * ((np.arange(2**count)[:, None] >> np.arange(count)) & 1)
    else:
        signs = np.random.default_rng(0).choice([-1, 1], size=(2**MAX_EXACT, count))
        signs[0] = 1
    sums = np.abs(signs @ differences)
    return float(np.mean(sums >= np.abs(differences.sum()) * (1 - 1e-9)))


def _made(report: Mapping[str, Any]) -> Mapping[str, Any]:
    """Returns the figures of what stands beside real motion, generated or reconstructed."""
    (row,) = report["rows"].keys() - {"real"}
    return report["rows"][row]


def compare_reports(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[Difference]:
    """Returns the differences of two reports in every metric both have.

    Raises:
        UserError: if their repeats do not belong together.
    """
    for name in SAME:
        if first[name] != second[name]:
            raise UserError(f"{name}: {first[name]} in one report, {second[name]} in the other; they do not compare")
    ours, theirs = _made(first), _made(second)
    rows = []
    for metric in ours:
        if metric not in theirs:
            continue
        one, other = (np.asarray(row[metric]["repeats"], np.float64) for row in (ours, theirs))
        if one.shape != other.shape or len(one) < 2:
            raise UserError(f"repeats: {len(one)} in one report, {len(other)} in the other; two or more of each needed")
        differences = other - one
        interval = 1.96 * differences.std(ddof=1) / np.sqrt(len(differences))
        rows.append(Difference(metric, one.mean(), other.mean(), interval, sign_test(differences)))
    return rows


def comparison_table(names: Sequence[str], differences: Sequence[Difference]) -> str:
    """Returns the Markdown table of a comparison; differences that chance would rarely make are bold."""
    lines = [f"| metric | {names[0]} | {names[1]} | difference | p |", "| --- | ---: | ---: | ---: | ---: |"]
    for row in differences:
        change = f"{row.second - row.first:+.3f} ± {row.interval:.3f}"
        change = f"**{change}**" if row.p_value < 0.05 else change
        p_value = f"{row.p_value:.4f}" if row.p_value >= 1e-4 else "< 0.0001"
        lines.append(f"| {row.metric} | {row.first:.3f} | {row.second:.3f} | {change} | {p_value} |")
    return "\n".join(lines)
