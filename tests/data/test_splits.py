from t2m_jax.data.splits import split_by_hash


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
