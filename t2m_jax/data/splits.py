"""Reproducible division of clips into train, val and test, and reproducible subsets."""

import hashlib
from collections.abc import Iterable, Sequence

from t2m_jax.data.files import MIRROR_PREFIX, SPLITS
from t2m_jax.errors import UserError

SHARES = {"train": 0.80, "val": 0.05, "test": 0.15}
"""Share of each split, as published with HumanML3D."""


def _rank(name: str, seed: str) -> bytes:
    """Returns a keyed hash that shuffles names. It does not depend on the Python version or the platform."""
    return hashlib.blake2b(name.encode(), key=seed.encode()).digest()


def split_by_hash(groups: Iterable[Sequence[str]], *, seed: str = "t2m_jax") -> dict[str, list[str]]:
    """Returns split -> sorted names: 80 % train, 5 % val and 15 % test, as closely as possible even for small groups.

    A group is shuffled by hash. Each of its clips goes to the split that is farthest below its share. The counts
    continue from group to group, so that groups of one clip do not all go to train.

    Args:
        groups: Names that should be distributed evenly over the splits, such as clips of one content and style.
        seed: Another seed gives another division.
    """
    counts = dict.fromkeys(SHARES, 0)
    result: dict[str, list[str]] = {split: [] for split in SPLITS}
    for group in groups:
        for name in sorted(group, key=lambda name: _rank(name, seed)):
            total = sum(counts.values()) + 1
            split = max(SHARES, key=lambda split: SHARES[split] * total - counts[split])
            counts[split] += 1
            result[split].append(name)
    return {split: sorted(names) for split, names in result.items()}


def nested_choice(names: Sequence[str], *, fraction: float, seed: int) -> list[str]:
    """Returns a share of the names in their order. A smaller share is part of a larger one with the same seed.

    A clip and its mirrored twin count as one and stay together.

    Args:
        names: Names of clips.
        fraction: Share of the originals, above 0 and up to 1. It is rounded to whole clips, and at least one.
        seed: Another seed gives another share.

    Raises:
        UserError: The fraction is not above 0 and up to 1.
    """
    if not 0 < fraction <= 1:
        raise UserError(f"fraction {fraction}: the share of the clips must be above 0 and at most 1")
    originals = {name.removeprefix(MIRROR_PREFIX) for name in names}
    ranked = sorted(originals, key=lambda name: (_rank(name, f"share {seed}"), name))
    chosen = set(ranked[: max(int(fraction * len(ranked) + 0.5), 1)])
    return [name for name in names if name.removeprefix(MIRROR_PREFIX) in chosen]
