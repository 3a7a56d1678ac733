"""Motions with captions on the device: lengths as the published loader uses them, crops, captions, tokens."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.data.banks.captions import caption_batch_at, caption_tokens, make_caption_bank, used_lengths
from t2m_jax.data.folder import Clip
from t2m_jax.data.texts import Caption
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.text.word_vectors import Vocabulary
from tests.jit import assert_jit_equals_eager

VOCABULARY = Vocabulary(("sos", "eos", "unk", "a", "b", "c", "d"))
LENGTHS = (4, 7, 12, 30)
MAX_FRAMES = 20


@pytest.mark.parametrize("unit", [4, 8])
def test_lengths_are_the_published_loader_s(golden_dir, unit):
    with np.load(golden_dir / "evaluation" / "length_rule.npz") as arrays:
        lengths = jnp.asarray(arrays["length"])
        for coin in ("single", "double"):
            found = used_lengths(lengths, jnp.full(lengths.shape, coin == "double"), unit=unit)
            np.testing.assert_array_equal(found, arrays[f"{coin}_unit{unit}"])


def test_a_motion_is_never_used_up():
    found = used_lengths(jnp.array([4, 7, 8]), jnp.array([True, True, True]))
    np.testing.assert_array_equal(found, [4, 4, 4])


@pytest.fixture(scope="module")
def bank():
    """Motions whose first column is 100 m + frame and whose captions name them."""
    samples = []
    for number, length in enumerate(LENGTHS):
        features = np.stack([100 * number + np.arange(length), np.ones(length)], axis=1).astype(np.float32)
        captions = tuple(Caption("x", (f"{'abcd'[number]}/X",) * words) for words in range(1, number + 2))
        samples.append(Clip(f"{number}", features, captions))
    normalizer = Normalizer(np.zeros(2, np.float32), np.full(2, 2.0, np.float32))
    return jax.device_put(make_caption_bank(samples, normalizer, VOCABULARY))


def batches(bank, num=150):
    draw = jax.jit(caption_batch_at, static_argnames=("batch_size", "window"))
    sizes = {"batch_size": 4, "window": MAX_FRAMES}
    return [jax.device_get(draw(bank, jax.random.key(3), step, **sizes)) for step in range(num)]


def test_crops_belong_to_their_captions(bank):
    lengths, starts, texts = {}, {}, {}
    for batch in batches(bank):
        assert batch.motion.shape == (4, MAX_FRAMES, 2)
        motions = []
        for motion, length, words, count in zip(
            batch.motion, batch.lengths, batch.captions.words, batch.captions.length, strict=True
        ):
            raw = 2 * motion[:length, 0]
            number = int(raw[0]) // 100
            np.testing.assert_array_equal(raw, raw[0] + np.arange(length))
            assert not motion[length:].any()
            assert set(words[1 : count - 1]) == {3 + number}
            motions.append(number)
            lengths.setdefault(number, []).append(int(length))
            starts.setdefault(number, set()).add(int(raw[0]) % 100)
            texts.setdefault(number, set()).add(int(count) - 2)
        assert sorted(motions) == [0, 1, 2, 3]
    assert {number: set(found) for number, found in lengths.items()} == {0: {4}, 1: {4}, 2: {8, 12}, 3: {20}}
    assert 1 / 4 < np.mean(np.array(lengths[2]) == 8) < 5 / 12
    assert starts == {0: {0}, 1: {0, 1, 2, 3}, 2: {0, 1, 2, 3, 4}, 3: set(range(11))}
    assert texts == {number: set(range(1, number + 2)) for number in range(4)}


@pytest.mark.slow
def test_a_batch_is_a_function_of_key_and_step(bank):
    one = caption_batch_at(bank, jax.random.key(1), 5, batch_size=3, window=MAX_FRAMES)
    other = caption_batch_at(bank, jax.random.key(1), jnp.array(5), batch_size=3, window=MAX_FRAMES)
    jax.tree.map(np.testing.assert_array_equal, one, other)


@pytest.mark.slow
def test_jit_equals_eager(bank):
    draw = jax.jit(caption_batch_at, static_argnames=("batch_size", "window"))
    assert_jit_equals_eager(draw, bank, jax.random.key(1), 5, rtol=0, batch_size=3, window=MAX_FRAMES)


def test_words_stand_in_for_tokens():
    assert caption_tokens(Caption("A b", ("x/NOUN",))) == ("x/NOUN",)
    assert caption_tokens(Caption("A b.")) == ("a", "b")
