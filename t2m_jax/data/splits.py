"""Dividing clips among train, val and test, the same way every time."""

import hashlib
from collections.abc import Iterable, Sequence

from t2m_jax.data.folder import SPLITS

SHARES = {"train": 0.80, "val": 0.05, "test": 0.15}
"""share of each split, as published with HumanML3D"""


def _rank(name: str, seed: str) -> bytes:
    """Returns a number that shuffles names: a keyed hash, which no Python version or platform changes."""
    return hashlib.blake2b(name.encode(), key=seed.encode()).digest()


def split_by_hash(groups: Iterable[Sequence[str]], *, seed: str = "t2m_jax") -> dict[str, list[str]]:
    """Returns split -> names, sorted, with 80 % train, 5 % val and 15 % test as near as can be, also over few groups.

    Args:
        groups: names which should be spread alike over the splits, such as clips of one content and style. A group is
            shuffled by hash and dealt out, each clip to the split that lags farthest behind its share so far; the
            counts run on from group to group, so that groups of one clip do not all go to train.
        seed: another one gives another division.
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
