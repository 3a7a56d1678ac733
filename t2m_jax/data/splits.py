"""Dividing clips among train, val and test, the same way every time."""

import hashlib
from collections.abc import Iterable, Sequence

from t2m_jax.data.files import MIRROR_PREFIX, SPLITS
from t2m_jax.errors import UserError

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


def nested_choice(names: Sequence[str], *, fraction: float, seed: int) -> list[str]:
    """Returns a share of the names, in their order: a smaller share is part of a larger one of the same seed.

    A clip and its mirrored twin count as one and stay together.

    Args:
        names: of clips.
        fraction: above 0 and up to 1; of the originals, rounded to whole ones, at least one.
        seed: another one gives another share.

    Raises:
        UserError: the fraction is none.
    """
    if not 0 < fraction <= 1:
        raise UserError(f"fraction {fraction}: a share of the clips is above 0 and up to 1")
    originals = {name.removeprefix(MIRROR_PREFIX) for name in names}
    ranked = sorted(originals, key=lambda name: (_rank(name, f"share {seed}"), name))
    chosen = set(ranked[: max(int(fraction * len(ranked) + 0.5), 1)])
    return [name for name in names if name.removeprefix(MIRROR_PREFIX) in chosen]
