"""Which clips are among the slowest and the fastest of their content."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from t2m_jax.data.captioning.captions import says_pace
from t2m_jax.data.files import POSITIONS
from t2m_jax.data.texts import Caption
from t2m_jax.motion.facts import Facts, measure
from t2m_jax.motion.skeleton import HUMANML3D

EXTREMES = {"very_slow": 0.1, "slow": 0.2, "fast": 0.8, "very_fast": 0.9}
"""Share of a content's clips that are slower than the limit of each extreme. A model is tested with the same limits."""
MARGIN = 0.05
"""Part of a limit by which a clip must be slower or faster than it, so that what a model learns lies inside."""
FEWEST = 50
"""Clips of a content that can be compared by speed."""


def measure_clips(folder: Path, names: Iterable[str]) -> dict[str, Facts]:
    """Returns the measurements of clips of a data set in the making."""
    return {name: measure(np.load(folder / POSITIONS / f"{name}.npy"), fps=HUMANML3D.fps) for name in names}


def speed_limits(facts: Mapping[str, Facts], contents: Mapping[str, str]) -> dict[str, dict[str, float]]:
    """Returns content -> extreme -> speed in m/s. Few clips cannot be compared, so their contents are left out.

    Args:
        facts: Clip -> measurements.
        contents: Clip -> content.
    """
    speeds = defaultdict(list)
    for name, content in contents.items():
        speeds[content].append(facts[name].speed)
    return {
        content: {extreme: float(np.quantile(values, share)) for extreme, share in EXTREMES.items()}
        for content, values in speeds.items()
        if len(values) >= FEWEST
    }


def find_extremes(facts: Facts, limits: Mapping[str, float] | None) -> list[str] | None:
    """Returns the extremes that a clip shows by a margin; None without limits."""
    if limits is None:
        return None
    slow = [name for name in EXTREMES if "slow" in name and facts.speed < limits[name] * (1 - MARGIN)]
    return slow + [name for name in EXTREMES if "fast" in name and facts.speed > limits[name] * (1 + MARGIN)]


def is_true_pace(caption: Caption, extremes: Sequence[str] | None) -> bool:
    """Returns whether a caption does not call a clip slow or fast that is not."""
    # Without limits of its content, nothing speaks against what a caption says.
    if extremes is None:
        return True
    # Tokens have no typing mistakes.
    text = " ".join(token.partition("/")[0] for token in caption.tokens)
    return all(pace in extremes or not says_pace(text, pace) for pace in ("slow", "fast"))


def shows_pace(content: str, facts: Facts) -> bool:
    """Returns whether a clip does enough for a sentence that says no more of it than how fast it is."""
    return facts.waves >= 2 or not content.startswith("wave")
