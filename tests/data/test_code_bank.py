"""Batches of codes and captions: which motion, offset, caption and piece a step sees."""

import collections

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.data.banks.codes import CodeBank, code_batch_at, crop_codes
from t2m_jax.text.bpe import CaptionTokens
from t2m_jax.text.caption_states import StateTable
from tests.jit import assert_jit_equals_eager

NUM_MOTIONS, OFFSETS, LONGEST, DEPTH = 7, 4, 9, 2
NUM_CAPTIONS = np.array([1, 3, 2, 1, 1, 4, 2])
batch_at = jax.jit(code_batch_at, static_argnames=("batch_size", "max_codes"))


@pytest.fixture(scope="module")
def bank():
    """Code n of motion m at offset o and depth r is 1000 r + 100 m + 10 o + n; caption q of motion m is m, then q."""
    motion, offset, number, depth = np.ogrid[:NUM_MOTIONS, :OFFSETS, :LONGEST, :DEPTH]
    lengths = np.maximum(2 + np.arange(NUM_MOTIONS)[:, None] - (np.arange(OFFSETS) > 1), 1)
    captions = [(owner, own) for owner, count in enumerate(NUM_CAPTIONS) for own in range(count)]
    return CodeBank(
        codes=jnp.asarray(1000 * depth + 100 * motion + 10 * offset + number),
        code_lengths=jnp.asarray(lengths),
        captions=CaptionTokens(jnp.asarray(captions), jnp.ones((len(captions), 2), bool)),
        first_caption=jnp.asarray(np.cumsum(NUM_CAPTIONS) - NUM_CAPTIONS),
        num_captions=jnp.asarray(NUM_CAPTIONS),
    )


def batches(bank, steps, *, batch_size=3, max_codes=20, seed=0):
    return [batch_at(bank, jax.random.key(seed), step, batch_size=batch_size, max_codes=max_codes) for step in steps]


def test_short_motions_are_kept_whole():
    codes = jnp.arange(40).reshape(2, 10, 2)
    cropped, lengths = crop_codes(codes, jnp.array([10, 4]), jax.random.split(jax.random.key(0), 2), max_codes=12)
    assert cropped.shape == (2, 12, 2)
    np.testing.assert_array_equal(lengths, [10, 4])
    np.testing.assert_array_equal(cropped[0, :10], codes[0])
    np.testing.assert_array_equal(cropped[1, :4], codes[1, :4])


def test_long_motions_are_cut_at_every_start_alike():
    length, window, trials = 10, 6, 5000
    codes = jnp.tile(jnp.arange(15)[None, :, None], (trials, 1, 1))
    keys = jax.random.split(jax.random.key(1), trials)
    cropped, lengths = crop_codes(codes, jnp.full(trials, length), keys, max_codes=window)
    np.testing.assert_array_equal(lengths, window)
    np.testing.assert_array_equal((cropped - cropped[:, :1])[..., 0], np.tile(np.arange(window), (trials, 1)))
    starts = np.bincount(np.asarray(cropped[:, 0, 0]), minlength=15)
    assert (starts[length - window + 1 :] == 0).all(), "a piece holds what lies past the motion's end"
    np.testing.assert_allclose(starts[: length - window + 1] / trials, 1 / 5, atol=0.03)


def test_a_batch_is_a_function_of_key_and_step(bank):
    for step in (0, 5, 123):
        one, again = batches(bank, [step, step])
        jax.tree.map(np.testing.assert_array_equal, one, again)
        traced = batch_at(bank, jax.random.key(0), jnp.array(step), batch_size=3, max_codes=20)
        jax.tree.map(np.testing.assert_array_equal, one, traced)
    other_step, other_key = batches(bank, [6])[0], batches(bank, [5], seed=1)[0]
    assert not np.array_equal(batches(bank, [5])[0].codes, other_step.codes)
    assert not np.array_equal(batches(bank, [5])[0].codes, other_key.codes)


def test_an_epoch_shows_each_motion_once_and_with_its_own_captions(bank):
    steps_an_epoch = NUM_MOTIONS // 3
    orders = []
    for epoch in range(4):
        seen = []
        for batch in batches(bank, range(epoch * steps_an_epoch, (epoch + 1) * steps_an_epoch)):
            owners = np.asarray(batch.codes[:, 0, 0]) // 100
            np.testing.assert_array_equal(batch.codes[:, 0, 1], batch.codes[:, 0, 0] + 1000)
            np.testing.assert_array_equal(batch.captions.tokens[:, 0], owners)
            assert (np.asarray(batch.captions.tokens[:, 1]) < NUM_CAPTIONS[owners]).all()
            seen += owners.tolist()
        assert len(set(seen)) == len(seen) == 3 * steps_an_epoch
        orders.append(tuple(seen))
    assert len(set(orders)) == 4


def test_lengths_belong_to_motion_and_offset(bank):
    for batch in batches(bank, range(20)):
        first = np.asarray(batch.codes[:, 0, 0])
        np.testing.assert_array_equal(batch.code_lengths, bank.code_lengths[first // 100, first // 10 % 10])
        np.testing.assert_array_equal(first % 10, 0)


@pytest.mark.slow
def test_offsets_and_captions_are_drawn_alike(bank):
    offsets, captions = collections.Counter(), collections.Counter()
    for batch in batches(bank, range(60), batch_size=7 * 8):
        offsets.update((np.asarray(batch.codes[:, 0, 0]) // 10 % 10).tolist())
        captions.update(own for owner, own in batch.captions.tokens.tolist() if owner == 5)
    for counts, kinds in ((offsets, OFFSETS), (captions, NUM_CAPTIONS[5])):
        shares = np.array([counts[kind] for kind in range(kinds)]) / counts.total()
        np.testing.assert_allclose(shares, 1 / kinds, atol=0.06)


@pytest.mark.slow
def test_a_bank_smaller_than_a_batch_is_repeated(bank):
    batch = batches(bank, [0], batch_size=2 * NUM_MOTIONS)[0]
    owners = (np.asarray(batch.codes[:, 0, 0]) // 100).tolist()
    assert collections.Counter(owners) == dict.fromkeys(range(NUM_MOTIONS), 2)


@pytest.mark.slow
def test_motions_are_drawn_by_their_shares(bank):
    weights = np.array([4.0, 1.0, 0.25, 0.25, 0.5, 0.5, 0.5])
    shared = bank._replace(shares=jnp.asarray(np.cumsum(weights) / weights.sum(), jnp.float32))
    owners = np.concatenate([batch.codes[:, 0, 0] // 100 for batch in batches(shared, range(200), batch_size=7)])
    np.testing.assert_allclose(np.bincount(owners, minlength=7) / 200, weights, atol=0.1)


def test_token_states_are_those_of_the_drawn_captions(bank):
    lengths = np.arange(1, 15, dtype=np.int32) % 4 + 1
    states = np.repeat(np.arange(14), lengths)[:, None].astype(np.float16)
    table = StateTable(states, np.cumsum(lengths) - lengths, lengths, np.arange(14), np.arange(4))
    tokens, found = (batches(bank._replace(captions=captions), [3])[0].captions for captions in (bank.captions, table))
    captions = np.cumsum(NUM_CAPTIONS)[tokens.tokens[:, 0]] - NUM_CAPTIONS[tokens.tokens[:, 0]] + tokens.tokens[:, 1]
    np.testing.assert_array_equal(found.numbers, captions)
    np.testing.assert_array_equal(found.mask.sum(axis=1), lengths[captions])
    np.testing.assert_array_equal(found.states[..., 0], captions[:, None] * found.mask)


@pytest.mark.slow
def test_jit_equals_eager(bank):
    assert_jit_equals_eager(batch_at, bank, jax.random.key(0), 3, rtol=0, batch_size=3, max_codes=4)
