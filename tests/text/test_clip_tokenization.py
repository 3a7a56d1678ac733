"""CLIP's tokens: those of the reference; what is broken is refused by name."""

import json

import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.text.bpe import CLIP_END, CLIP_START, clip_tokens, load_clip_bpe
from tests.clip_golden import CAPTIONS, FULL, TEXT_ONLY, golden

MAX_LENGTH = 77


def refused(folder) -> str:
    with pytest.raises(UserError) as caught:
        load_clip_bpe(folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture(scope="module")
def tokenizer():
    return load_clip_bpe(FULL)


def test_the_tokens_are_those_of_the_reference(tokenizer):
    tokens = clip_tokens(tokenizer, CAPTIONS, max_length=MAX_LENGTH)
    assert tokens.dtype == np.int32
    assert len(CAPTIONS) == 64
    np.testing.assert_array_equal(tokens, golden(FULL, "tokens"))


def test_added_tokens_are_those_of_the_reference():
    tokens = clip_tokens(load_clip_bpe(TEXT_ONLY), CAPTIONS, max_length=MAX_LENGTH)
    np.testing.assert_array_equal(tokens, golden(TEXT_ONLY, "tokens"))
    assert tokens.max() > golden(FULL, "tokens").max()


def test_an_empty_caption_is_start_and_end(tokenizer):
    start, end = tokenizer.token_to_id(CLIP_START), tokenizer.token_to_id(CLIP_END)
    for caption in ("", "  ", "\n"):
        np.testing.assert_array_equal(clip_tokens(tokenizer, [caption], max_length=4), [[start, end, end, end]])


def test_a_long_caption_loses_its_tail_and_keeps_its_end(tokenizer):
    caption = " ".join(f"step {number}" for number in range(60))
    whole = clip_tokens(tokenizer, [caption], max_length=1000)[0]
    cut = clip_tokens(tokenizer, [caption], max_length=MAX_LENGTH)[0]
    end = tokenizer.token_to_id(CLIP_END)
    assert list(whole).index(end) > MAX_LENGTH
    np.testing.assert_array_equal(cut[:-1], whole[: MAX_LENGTH - 1])
    assert cut[-1] == end


def test_case_and_spaces_do_not_matter(tokenizer):
    plain, odd = clip_tokens(tokenizer, ["a person walks", "  A  Person\tWALKS\n"], max_length=MAX_LENGTH)
    np.testing.assert_array_equal(plain, odd)


def test_a_caption_does_not_depend_on_its_neighbours(tokenizer):
    together = clip_tokens(tokenizer, CAPTIONS, max_length=MAX_LENGTH)
    for row in range(0, len(CAPTIONS), 7):
        alone = clip_tokens(tokenizer, [CAPTIONS[row]], max_length=MAX_LENGTH)
        np.testing.assert_array_equal(together[row], alone[0])


def test_no_captions_are_no_rows(tokenizer):
    assert clip_tokens(tokenizer, [], max_length=MAX_LENGTH).shape == (0, MAX_LENGTH)


def test_cutting_and_filling_that_a_file_asks_for_are_left_out(tokenizer, tmp_path):
    data = json.loads((FULL / "tokenizer.json").read_text())
    data["truncation"] = {"direction": "Right", "max_length": 5, "strategy": "LongestFirst", "stride": 0}
    data["padding"] = {
        "strategy": {"Fixed": 9},
        "direction": "Left",
        "pad_to_multiple_of": None,
        "pad_id": 0,
        "pad_type_id": 0,
        "pad_token": "!",
    }
    (tmp_path / "tokenizer.json").write_text(json.dumps(data))
    tokens = clip_tokens(load_clip_bpe(tmp_path), CAPTIONS, max_length=MAX_LENGTH)
    np.testing.assert_array_equal(tokens, golden(FULL, "tokens"))


def test_a_folder_without_a_tokenizer_is_named(tmp_path):
    assert f"{tmp_path / 'tokenizer.json'}: there is no such file" in refused(tmp_path)


def test_a_tokenizer_that_is_not_clips_is_named(tmp_path):
    text = (FULL / "tokenizer.json").read_text(encoding="utf-8")
    (tmp_path / "tokenizer.json").write_text(text.replace(CLIP_START, "<s>"), encoding="utf-8")
    assert CLIP_START in refused(tmp_path)
