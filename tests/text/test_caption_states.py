"""Token states of captions on disk: read once, the same in every batch, and computed again if they are damaged."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.text.caption_states import STATES, open_state_table

CAPTIONS = ["walk", "a person jumps", "walk", "go"]
WIDTH = 3


def states_of(text):
    """One row for each letter, which tells text and place."""
    return np.array([[ord(letter), place, len(text)] for place, letter in enumerate(text)], np.float16)


class Encoder:
    """Counts what it reads; gives texts in another order than they are asked for."""

    def __init__(self):
        self.texts = []

    def __call__(self, captions):
        self.texts += captions
        for caption in reversed(captions):
            yield caption, states_of(caption)


def open_table(places, encoder, captions=CAPTIONS, *, name="encoder", max_length=64):
    return jax.tree.map(jnp.asarray, open_state_table(places, name, captions, encoder, max_length=max_length))


def test_batches_have_the_states_of_their_captions(tmp_path):
    table = open_table([tmp_path], Encoder())
    batch = table.batch(jnp.array([1, 2, 0, 3]))
    assert batch.states.shape == (4, 16, WIDTH) and batch.states.dtype == np.float32
    assert batch.numbers[1] == batch.numbers[2] and len(set(batch.numbers.tolist())) == 3
    for text, states, mask in zip(["a person jumps", "walk", "walk", "go"], batch.states, batch.mask, strict=True):
        np.testing.assert_array_equal(states[mask], states_of(text))
        assert mask[: len(text)].all() and not np.asarray(states)[len(text) :].any()


def test_long_captions_are_cut(tmp_path):
    batch = open_table([tmp_path], Encoder(), max_length=5).batch(jnp.array([0, 1]))
    np.testing.assert_array_equal(batch.mask.sum(axis=1), [4, 5])
    np.testing.assert_array_equal(batch.states[1], states_of("a person jumps")[:5])


def test_each_text_is_read_once_by_each_encoder(tmp_path):
    encoder = Encoder()
    open_table([tmp_path], encoder)
    assert sorted(encoder.texts) == ["a person jumps", "go", "walk"]
    open_table([tmp_path], encoder, ["go", "walk"])
    open_table([tmp_path], encoder, list(reversed(CAPTIONS)))
    assert len(encoder.texts) == 3
    open_table([tmp_path], encoder, [*CAPTIONS, "wave"])
    assert encoder.texts[3:] == ["wave"]
    open_table([tmp_path], encoder, name="another")
    assert len(encoder.texts) == 7


def test_damaged_states_are_computed_again(tmp_path, caplog):
    open_table([tmp_path], Encoder())
    (path,) = tmp_path.glob(f"*/{STATES}")
    path.write_bytes(path.read_bytes()[:-1] + b"\x77")
    encoder = Encoder()
    table = open_table([tmp_path], encoder)
    assert len(encoder.texts) == 3 and "computed again" in caplog.text
    np.testing.assert_array_equal(table.batch(jnp.array([3])).states[0, :2], states_of("go"))


def test_the_second_place_is_used_if_the_first_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    places = [tmp_path / "file" / "states", tmp_path / "second"]
    open_table(places, Encoder())
    assert list(places[1].iterdir())
    with pytest.raises(UserError, match="cannot be written"):
        open_table(places[:1], Encoder())
