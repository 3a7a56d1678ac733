import itertools

import pytest

from t2m_jax.data.splits import nested_choice, split_by_hash
from t2m_jax.errors import UserError


def test_every_name_is_in_one_split_with_the_right_shares():
    names = [f"clip{number}" for number in range(1000)]
    splits = split_by_hash([names])
    assert sorted(name for members in splits.values() for name in members) == sorted(names)
    assert {split: len(members) for split, members in splits.items()} == {"train": 800, "val": 50, "test": 150}


def test_groups_are_spread_and_small_groups_reach_every_split():
    groups = [[f"{group}-{number}" for number in range(20)] for group in range(5)]
    splits = split_by_hash(groups)
    for group in range(5):
        counts = [sum(name.startswith(f"{group}-") for name in splits[split]) for split in ("train", "val", "test")]
        assert counts == [16, 1, 3]
    single = split_by_hash([[f"clip{number}"] for number in range(40)])
    assert {split: len(members) for split, members in single.items()} == {"train": 32, "val": 2, "test": 6}


def test_order_of_names_does_not_matter_and_the_seed_does():
    names = [f"clip{number}" for number in range(60)]
    assert split_by_hash([names]) == split_by_hash([names[::-1]])
    assert split_by_hash([names]) != split_by_hash([names], seed="another")


SHARES = (0.1, 0.2, 0.5, 0.8, 1.0)


def twins(num_clips):
    return [name for number in range(num_clips) for name in (f"{number:06d}", f"M{number:06d}")]


@pytest.mark.parametrize("num_clips", [1, 7, 100, 333])
def test_shares_are_nested_and_of_the_right_size_and_twins_stay_together(num_clips):
    names = twins(num_clips)
    choices = [nested_choice(names, fraction=share, seed=5) for share in SHARES]
    for share, chosen in zip(SHARES, choices, strict=True):
        assert abs(len(chosen) / 2 - share * num_clips) <= 0.5 or len(chosen) == 2
        assert {name.removeprefix("M") for name in chosen if name[0] != "M"} == {
            name.removeprefix("M") for name in chosen if name[0] == "M"
        }
        assert chosen == [name for name in names if name in chosen]
    assert all(set(small) <= set(large) for small, large in itertools.pairwise(choices))
    assert choices[-1] == names


def test_a_share_depends_on_names_and_seed_alone():
    names = twins(50)
    chosen = nested_choice(names, fraction=0.1, seed=0)
    assert chosen == sorted(nested_choice(names[::-1], fraction=0.1, seed=0), key=names.index)
    assert chosen != nested_choice(names, fraction=0.1, seed=1)
    # Written down once: neither Python's version nor the platform may change it.
    assert [name for name in chosen if name[0] != "M"] == ["000004", "000014", "000017", "000021", "000048"]


@pytest.mark.parametrize("fraction", [0.0, -0.5, 1.01, float("nan")])
def test_what_is_no_share_is_refused(fraction):
    with pytest.raises(UserError, match="share"):
        nested_choice(twins(3), fraction=fraction, seed=0)
