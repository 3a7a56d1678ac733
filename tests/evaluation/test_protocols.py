"""What the protocols look at: counts, crops, captions, pairs, seeds; lengths against the reference's."""

import dataclasses

import numpy as np
import pytest

from t2m_jax.data.folder import Clip
from t2m_jax.data.texts import Caption
from t2m_jax.errors import UserError
from t2m_jax.evaluation.protocols import BATCH, PROTOCOLS, find_protocol, make_plan


def make_samples(count):
    generator = np.random.default_rng(0)
    return [
        Clip(
            f"clip{number}",
            np.zeros((int(generator.integers(40, 200)), 3), np.float32),
            tuple(Caption(f"caption {index}") for index in range(int(generator.integers(1, 5)))),
        )
        for number in range(count)
    ]


SAMPLES = make_samples(413)


def plan(name, *, samples=SAMPLES, seed=1, repeat=0, unit=4, **rules):
    protocol = dataclasses.replace(find_protocol(name), **rules)
    return make_plan(samples, protocol, seed=seed, repeat=repeat, unit=unit)


@pytest.mark.parametrize("name", ["t2m-gpt", "t2m-gpt-paper", "text-to-motion", "momask"])
def test_the_fields_protocols_drop_the_tail_and_draw(name):
    found = plan(name)
    assert len(found.samples) == 413 // BATCH * BATCH
    assert len(np.unique(found.samples)) == len(found.samples)
    frames = np.array([len(SAMPLES[owner].features) for owner in found.samples])
    assert (found.starts + found.lengths <= frames).all()
    assert (found.lengths % 4 == 0).all()
    lost = frames // 4 - found.lengths // 4
    assert set(lost) == {0, 1}
    np.testing.assert_allclose(np.mean(lost), 1 / 3, atol=0.08)
    captions = [len(SAMPLES[owner].captions) for owner in found.samples]
    assert (found.captions < captions).all() and found.captions.max() > 0
    assert found.diversity_pairs.shape == (300, 2)


def test_strict_looks_at_everything_once_and_whole():
    found = plan("strict")
    everything = {(owner, caption) for owner, one in enumerate(SAMPLES) for caption in range(len(one.captions))}
    assert set(zip(found.samples.tolist(), found.captions.tolist(), strict=True)) == everything
    assert len(found.samples) == len(everything)
    np.testing.assert_array_equal(found.starts, 0)
    np.testing.assert_array_equal(found.lengths, [len(SAMPLES[owner].features) // 4 * 4 for owner in found.samples])
    first_round = found.samples[: len(SAMPLES)]
    assert len(np.unique(first_round)) == len(SAMPLES), "a batch holds a motion twice without need"


@pytest.mark.parametrize(("name", "varied"), [("t2m-gpt", 384), ("text-to-motion", 100), ("momask", 96)])
def test_whose_variety_is_measured(name, varied):
    found = plan(name)
    assert len(found.varied) == len(np.unique(found.varied)) == varied
    assert found.multimodality_pairs.shape == (10, 2)
    for column in found.multimodality_pairs.T:
        assert len(np.unique(column)) == 10 and column.max() < 30


def test_the_paper_of_t2m_gpt_has_ten_pairs_of_twenty_motions():
    paper, code = find_protocol("t2m-gpt-paper"), find_protocol("t2m-gpt")
    assert dataclasses.replace(paper, name="t2m-gpt", samples_per_caption=30, disjoint_pairs=False) == code
    for seed in range(20):
        found, by_code = plan("t2m-gpt-paper", seed=seed), plan("t2m-gpt", seed=seed)
        np.testing.assert_array_equal(np.sort(found.multimodality_pairs, axis=None), np.arange(20))
        assert found.multimodality_pairs.shape == (10, 2) and len(found.varied) == 384
        for one, other in zip(found[:-1], by_code[:-1], strict=True):  # all other choices are those of the code
            np.testing.assert_array_equal(one, other)


def test_a_repeat_is_a_function_of_seed_and_number():
    one, again, next_repeat, other_seed = (
        plan("t2m-gpt"),
        plan("t2m-gpt"),
        plan("t2m-gpt", repeat=1),
        plan("t2m-gpt", seed=2),
    )
    for left, right in zip(one, again, strict=True):
        np.testing.assert_array_equal(left, right)
    for other in (next_repeat, other_seed):
        assert not np.array_equal(one.samples, other.samples)
        assert not np.array_equal(one.diversity_pairs, other.diversity_pairs)


def test_few_motions():
    assert len(plan("t2m-gpt", samples=SAMPLES[:150]).diversity_pairs) == 100
    assert len(plan("t2m-gpt", samples=SAMPLES[:40]).diversity_pairs) == 31
    with pytest.raises(UserError, match=r"20 motions with captions do not fill a batch of 32; .*--batch 20`"):
        plan("t2m-gpt", samples=SAMPLES[:20])
    assert len(plan("t2m-gpt", samples=SAMPLES[:20], batch=20).samples) == 20
    assert len(plan("t2m-gpt", samples=SAMPLES[:20], batch=8).samples) == 16
    with pytest.raises(UserError, match="batch: 3 is too small"):
        plan("t2m-gpt", batch=3)


@pytest.mark.parametrize("unit", [4, 8, 12])
def test_lengths_are_multiples_of_the_unit(unit):
    for name in PROTOCOLS:
        found = plan(name, unit=unit)
        frames = np.array([len(SAMPLES[owner].features) for owner in found.samples])
        assert (found.lengths % unit == 0).all() and (found.starts + found.lengths <= frames).all()
        assert set(frames // unit - found.lengths // unit) == ({0} if name == "strict" else {0, 1})


def test_an_unknown_protocol_is_one_line():
    with pytest.raises(UserError, match="'strikt' is unknown; known: t2m-gpt"):
        find_protocol("strikt")
    assert set(PROTOCOLS) == {"t2m-gpt", "t2m-gpt-paper", "text-to-motion", "benchmark", "momask", "strict"}
