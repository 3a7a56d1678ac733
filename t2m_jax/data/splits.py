"""Reproducible division of clips into train, val and test, and reproducible subsets."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence

from t2m_jax.data.files import MIRROR_PREFIX, SPLITS
from t2m_jax.errors import UserError

SHARES = {"train": 0.80, "val": 0.05, "test": 0.15}
"""Share of each split, as published with HumanML3D."""


def _rank(name: str, seed: str) -> bytes:
    """Returns a keyed hash that shuffles names. It does not depend on the Python version or the platform."""
    return hashlib.blake2b(name.encode(), key=seed.encode()).digest()


def split_by_hash(
    groups: Iterable[Sequence[str]], *, seed: str = "t2m_jax", shares: Mapping[str, float] = SHARES
) -> dict[str, list[str]]:
    """Returns split -> sorted names, as close to the shares as possible even for small groups.

    A group is shuffled by hash. Each of its clips goes to the split that is farthest below its share. The counts
    continue from group to group, so that groups of one clip do not all go to train.

    Args:
        groups: Names that should be distributed evenly over the splits, such as clips of one content and style.
        seed: Another seed gives another division.
        shares: Share of each split, with the sum 1.
    """
    counts = dict.fromkeys(shares, 0)
    result: dict[str, list[str]] = {split: [] for split in SPLITS}
    for group in groups:
        for name in sorted(group, key=lambda name: _rank(name, seed)):
            total = sum(counts.values()) + 1
            split = max(shares, key=lambda split: shares[split] * total - counts[split])
            counts[split] += 1
            result[split].append(name)
    return {split: sorted(names) for split, names in result.items()}


def split_groups(
    groups: Mapping[str, Sequence[str]], *, shares: Mapping[str, float], seed: str
) -> dict[str, list[str]]:
    """Returns split -> sorted names, as close to the shares as whole groups allow. Each split gets at least one group.

    Args:
        groups: Names of clips that stay together, such as all clips of one actor.
        shares: Share of each split, with the sum 1.
        seed: Another seed gives another division.

    Raises:
        UserError: There are fewer groups than splits.
    """
    wanted = [split for split, share in shares.items() if share > 0]
    if len(groups) < len(wanted):
        raise UserError(f"there are {len(groups)} groups, which cannot be divided among {', '.join(wanted)}")
    room = {split: shares[split] * sum(map(len, groups.values())) for split in wanted}
    members: dict[str, list[str]] = {split: [] for split in SPLITS}
    # The largest groups first, while every split has room for them.
    for group in sorted(groups, key=lambda group: (-len(groups[group]), _rank(group, seed))):
        split = max(room, key=lambda split: room[split])
        room[split] -= len(groups[group])
        members[split].append(group)
    for split in wanted:
        if not members[split]:  # the groups are in order of their sizes
            members[split].append(max(members.values(), key=len).pop())
    return {split: sorted(name for group in found for name in groups[group]) for split, found in members.items()}


def parse_shares(text: str) -> dict[str, float]:
    """Returns the share of each split from a text such as `80/5/15`.

    Raises:
        UserError: It does not have three numbers from 0, of which the first is above 0.
    """
    parts = text.split("/")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) != len(SPLITS) or not all(0 <= number <= 1e6 for number in numbers) or numbers[0] == 0:
        raise UserError(
            f"split {text!r}: give the shares of train, val and test, such as 80/5/15, or a folder of lists"
        )
    return {split: number / sum(numbers) for split, number in zip(SPLITS, numbers, strict=True)}


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
    # Not `round`, which rounds halves to even numbers.
    chosen = set(ranked[: max(int(fraction * len(ranked) + 0.5), 1)])
    return [name for name in names if name.removeprefix(MIRROR_PREFIX) in chosen]
