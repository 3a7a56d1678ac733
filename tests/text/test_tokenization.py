"""Captions as tokens: determinism, padding, truncation, letters never seen, files."""

import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.text.bpe import (
    PAD,
    TOKENIZER_FILE,
    UNKNOWN,
    load_bpe,
    save_bpe,
    tokenize_captions,
    train_bpe,
)
from tests.tiny import CAPTIONS


@pytest.fixture(scope="module")
def tokenizer():
    return train_bpe(CAPTIONS, vocabulary_size=60)


def words(tokenizer, caption: str) -> list[str]:
    found = tokenize_captions(tokenizer, [caption], max_length=40)
    return [tokenizer.id_to_token(token) for token in found.tokens[0][found.mask[0]]]


def test_the_same_captions_make_the_same_tokenizer(tokenizer):
    again = train_bpe(iter(CAPTIONS), vocabulary_size=60)
    assert again.to_str() == tokenizer.to_str()
    assert tokenizer.get_vocab_size() == 60
    assert tokenizer.token_to_id(PAD) == 0


def test_frequent_words_are_one_token_and_rare_ones_are_spelt(tokenizer):
    assert words(tokenizer, "a person") == ["a", "person"]
    assert words(tokenizer, "quiz") == ["q", "u", "i", "z"]


def test_case_and_compatibility_forms_do_not_matter(tokenizer):
    assert words(tokenizer, "A Person WALKS") == words(tokenizer, "a person walks")
    assert words(tokenizer, "\uff41 \uff50\uff45\uff52\uff53\uff4f\uff4e walks") == words(tokenizer, "a person walks")


def test_letters_never_seen_are_unknown_and_shift_nothing(tokenizer):
    assert words(tokenizer, "a 人 person") == ["a", UNKNOWN, "person"]


def test_padding_is_token_0_and_masked(tokenizer):
    tokens, mask = tokenize_captions(tokenizer, ["a person", "a person walks forward"], max_length=12)
    assert tokens.shape == mask.shape == (2, 12)
    assert tokens.dtype == np.int32
    for row, row_mask in zip(tokens, mask, strict=True):
        length = row_mask.sum()
        assert row_mask[:length].all()
        assert (row[:length] != 0).all()
        np.testing.assert_array_equal(row[length:], 0)
    np.testing.assert_array_equal(tokens[0, :2], tokens[1, :2])


def test_long_captions_keep_their_beginning(tokenizer):
    long = "a person walks forward and turns left"
    whole = tokenize_captions(tokenizer, [long], max_length=40)
    assert whole.mask.sum() > 4
    cut = tokenize_captions(tokenizer, [long], max_length=4)
    np.testing.assert_array_equal(cut.tokens[0], whole.tokens[0, :4])
    assert cut.mask.all()


def test_a_caption_does_not_depend_on_its_neighbours(tokenizer):
    together = tokenize_captions(tokenizer, CAPTIONS, max_length=16)
    for row, caption in enumerate(CAPTIONS):
        alone = tokenize_captions(tokenizer, [caption], max_length=16)
        np.testing.assert_array_equal(together.tokens[row], alone.tokens[0])
        np.testing.assert_array_equal(together.mask[row], alone.mask[0])


def test_files_give_back_the_same_tokens(tokenizer, tmp_path):
    save_bpe(tmp_path, tokenizer)
    loaded = load_bpe(tmp_path)
    captions = [*CAPTIONS, "a 人 QUIZ"]
    np.testing.assert_array_equal(
        tokenize_captions(loaded, captions, max_length=16).tokens,
        tokenize_captions(tokenizer, captions, max_length=16).tokens,
    )


@pytest.mark.parametrize(
    "content", [None, b"", b"{", b"{}", b'{"model": 3}', b"\xff\xfe\x00", b"[" * 100_000, b'{"version": "9"}']
)
def test_files_that_are_no_tokenizer_are_named(content, tmp_path):
    path = tmp_path / TOKENIZER_FILE
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UserError) as caught:
        load_bpe(tmp_path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_tokenizer_file_that_is_a_folder_is_named(tmp_path):
    (tmp_path / TOKENIZER_FILE).mkdir()
    with pytest.raises(UserError, match=TOKENIZER_FILE):
        load_bpe(tmp_path)
