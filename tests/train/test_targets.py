"""Targets and corruption against the original's arrays."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.data.banks.codes import CodeBank
from t2m_jax.models.motion_gpt import MotionGptConfig
from t2m_jax.train import LoopConfig
from t2m_jax.train.gpt import Corruption, TrainGptConfig, draw_corruption, drop_one_code, make_targets, training_batch
from tests.jit import assert_jit_equals_eager


def test_golden_targets(golden_dir):
    arrays = np.load(golden_dir / "t2m_gpt" / "targets.npz")
    cases = sorted({key.split("/")[0] for key in arrays if key.startswith("case")})
    assert len(cases) == 36
    for block in (26, 51):
        chosen = [case for case in cases if arrays[f"{case}/block"] == block]
        tokens = [arrays[f"{case}/tokens"] for case in chosen]
        codes = jnp.array([np.pad(row, (0, block - 1 - len(row))) for row in tokens])
        lengths = jnp.array([len(row) for row in tokens])
        drop, drop_tail = (
            jnp.array([bool(arrays[f"{case}/{name}"]) for case in chosen]) for name in ("drop", "drop_tail")
        )
        codes, lengths = drop_one_code(codes, lengths, drop, at_head=~drop_tail)
        assert all(arrays[f"{case}/nb_code"] == 512 for case in chosen)
        targets = jax.device_get(make_targets(codes, lengths, config=MotionGptConfig(num_codes=512, block_size=block)))
        np.testing.assert_array_equal(targets.tokens, [arrays[f"{case}/target"] for case in chosen])
        np.testing.assert_array_equal(targets.code_lengths, [arrays[f"{case}/n_tokens"] for case in chosen])


def test_golden_corruption(golden_dir):
    arrays = np.load(golden_dir / "t2m_gpt" / "corruption.npz")
    cases = sorted({key.split("/")[0] for key in arrays if key.endswith("/corrupted")})
    assert cases
    for case in cases:
        keep = jnp.asarray(arrays[f"{case}/mask_keep"]).astype(bool)
        corruption = Corruption(keep, jnp.asarray(arrays[f"{case}/random_indices"]))
        found = corruption.apply(jnp.asarray(arrays[f"{case}/input_index"]))
        np.testing.assert_array_equal(found, arrays[f"{case}/corrupted"])


@functools.partial(jax.jit, static_argnames="past_end")
def corrupted(tokens, key, *, tau, past_end):
    """Tokens as in training, with a key for each motion."""
    keys = jax.random.split(key, len(tokens))
    return draw_corruption(tokens, keys, num_codes=8, tau=tau, past_end=past_end).apply(tokens)


def test_random_corruption_replaces_the_right_share():
    tokens = jnp.full((200, 50), 99)
    found = corrupted(tokens, jax.random.key(0), tau=0.3, past_end=True)
    np.testing.assert_allclose(np.mean(found == 99), 0.7, atol=0.02)
    assert set(np.unique(found)) == {*range(8), 99}
    untouched = corrupted(tokens, jax.random.key(0), tau=0.0, past_end=True)
    np.testing.assert_array_equal(untouched, tokens)
    everything = corrupted(tokens, jax.random.key(0), tau=1.0, past_end=True)
    assert np.max(everything) < 8


def replaced_shares(tau, num_steps):
    """The share of the inputs that is replaced, by step and motion; almost all of them are Pad."""
    config = TrainGptConfig(
        text_encoder="clip",
        model=MotionGptConfig(num_codes=8, text_dim=4, embed_dim=8, num_heads=2, block_size=2001),
        tau=tau,
        loop=LoopConfig(batch_size=40),
    )
    ones = jnp.ones(40, jnp.int32)
    bank = CodeBank(jnp.zeros((40, 1, 3, 1), jnp.int32), 3 * ones[:, None], jnp.zeros((40, 4)), jnp.arange(40), ones)

    @jax.jit
    def shares_at(step):
        batch = training_batch(bank, step, config=config)
        return jnp.mean(batch.inputs != batch.tokens[:, :-1], axis=1)

    return np.stack([shares_at(step) for step in range(num_steps)])


@pytest.mark.slow
def test_a_share_is_drawn_for_each_batch():
    batches = replaced_shares("per_batch", num_steps=40)
    assert np.ptp(batches, axis=1).max() < 0.1, "motions of one batch differ"
    assert batches.min() < 0.1 and batches.max() > 0.9


@pytest.mark.slow
def test_a_share_is_drawn_for_each_motion():
    motions = replaced_shares("per_motion", num_steps=10)
    assert motions[0].min() < 0.15 and motions[0].max() > 0.85
    np.testing.assert_allclose(motions.mean(), 0.5, atol=0.05)


@pytest.mark.slow
def test_a_given_share_is_that_of_every_motion():
    np.testing.assert_allclose(replaced_shares(0.3, num_steps=2), 0.3, atol=0.06)


def test_the_corruption_of_a_motion_does_not_depend_on_the_others():
    tokens, keys = jnp.full((6, 50), 99), jax.random.split(jax.random.key(3), 6)
    draw = jax.jit(functools.partial(draw_corruption, tau="per_motion", num_codes=8, past_end=True))
    together, alone = draw(tokens, keys), draw(tokens[2:4], keys[2:4])
    np.testing.assert_array_equal(together.keep[2:4], alone.keep)
    np.testing.assert_array_equal(together.replacements[2:4], alone.replacements)
    assert len(np.unique(np.asarray(together.replacements), axis=0)) == 6


def test_end_and_pad_can_be_left_alone():
    tokens = jnp.tile(jnp.array([1, 2, 3, 8, 9, 9]), (100, 1))
    found = corrupted(tokens, jax.random.key(0), tau=1.0, past_end=False)
    np.testing.assert_array_equal(found[:, 3:], tokens[:, 3:])
    assert len(np.unique(found[:, :3])) == 8


def test_head_and_tail_are_dropped():
    codes = jnp.array([[5, 6, 7, 0]] * 3)
    drop, at_head = jnp.array([True, True, False]), jnp.array([True, False, True])
    found, lengths = drop_one_code(codes, jnp.array([3, 3, 3]), drop, at_head=at_head)
    assert lengths.tolist() == [2, 2, 3]
    assert [row[:length].tolist() for row, length in zip(found, lengths, strict=True)] == [[6, 7], [5, 6], [5, 6, 7]]


@pytest.mark.slow
def test_long_motions_are_cut_to_leave_room_for_end():
    targets = make_targets(jnp.arange(9)[None], jnp.array([9]), config=MotionGptConfig(num_codes=20, block_size=6))
    np.testing.assert_array_equal(targets.tokens, [[0, 1, 2, 3, 4, 20]])


@pytest.mark.slow
def test_jit_equals_eager():
    codes, lengths = jnp.arange(12).reshape(3, 4), jnp.array([4, 2, 0])

    def build(codes, lengths):
        return make_targets(codes, lengths, config=MotionGptConfig(num_codes=30, block_size=7))

    assert_jit_equals_eager(jax.jit(build), codes, lengths)
