"""Captions as the evaluator reads them: the reference's numbers, own vocabularies, broken captions, vectors."""

import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.text.word_vectors import (
    MAX_WORDS,
    OTHER,
    PARTS_OF_SPEECH,
    SPECIAL_WORDS,
    TEXT_LENGTH,
    Vocabulary,
    load_vector_table,
    load_vocabulary,
    load_word_vectors,
    part_of_speech,
    save_vocabulary,
    tokens_from_text,
    vocabulary_from_captions,
)

SMALL = Vocabulary(("sos", "eos", "unk", "a", "man", "walk", "left", "wave"))
VERB, NOUN = 0, 1


@pytest.fixture(scope="module")
def golden(golden_dir):
    with np.load(golden_dir / "evaluation" / "text_vectorization.npz") as file:
        return dict(file)


def rows(vocabulary, golden):
    return vocabulary.vectorize_all([str(caption).split(" ") for caption in golden["captions"]])


def test_captions_become_the_reference_s_numbers(golden, shared_dir):
    vocabulary = load_vocabulary(shared_dir / "data" / "humanml3d-vocabulary.txt")
    found = rows(vocabulary, golden)
    assert len(vocabulary) == golden["vocab_size"]
    np.testing.assert_array_equal(found.words, golden["word_ids"])
    np.testing.assert_array_equal(found.parts_of_speech, golden["pos_ids"])
    np.testing.assert_array_equal(found.length, golden["sent_len"])
    for word, number in zip(golden["vip_words"], golden["vip_word_id"], strict=True):
        assert (str(word) in vocabulary) == (number >= 0)


def test_the_rule_holds_with_any_list_that_has_the_words(golden):
    """Of the reference's numbers all but the order of its list, which is not ours to pass on."""
    used = [str(word) for word in golden["used_words"]]
    found = rows(Vocabulary(used), golden)
    np.testing.assert_array_equal(golden["used_word_ids"][found.words], golden["word_ids"])
    np.testing.assert_array_equal(found.parts_of_speech, golden["pos_ids"])
    np.testing.assert_array_equal(found.length, golden["sent_len"])


def test_classes_are_the_reference_s(golden):
    assert tuple(golden["pos_class_names"]) == PARTS_OF_SPEECH
    special = {word: name for name, words in SPECIAL_WORDS.items() for word in words.split()}
    pairs = zip(golden["vip_words"], golden["vip_class"], strict=True)
    expected = {str(word): PARTS_OF_SPEECH[number] for word, number in pairs}
    assert special == expected
    assert len(special) == 81


@pytest.mark.parametrize(
    ("token", "word", "kind"),
    [
        ("man/NOUN", "man", NOUN),
        ("man", "man", OTHER),
        ("man/", "man", OTHER),
        ("man/noun", "man", OTHER),
        ("man/NOUN/NOUN", "man", OTHER),
        ("/NOUN", "unk", OTHER),
        ("/", "unk", OTHER),
        ("", "unk", OTHER),
        ("Man/NOUN", "unk", OTHER),
        ("zorblax/NOUN", "unk", OTHER),
        ("unk/NOUN", "unk", NOUN),
        ("walk", "walk", PARTS_OF_SPEECH.index("Act_VIP")),
        ("left/VERB", "left", PARTS_OF_SPEECH.index("Loc_VIP")),
    ],
)
def test_one_token(token, word, kind):
    found = SMALL.vectorize([token])
    assert found.length == 3
    assert SMALL.words[found.words[1]] == word
    assert found.parts_of_speech[1] == kind
    assert part_of_speech("sos", "") == OTHER


def test_no_caption_is_too_long_too_short_or_too_strange():
    empty = SMALL.vectorize(())
    assert empty.length == 2
    np.testing.assert_array_equal(empty.words, [0, 1] + [2] * (TEXT_LENGTH - 2))
    np.testing.assert_array_equal(empty.parts_of_speech, np.full(TEXT_LENGTH, OTHER))
    long = SMALL.vectorize(["walk/VERB"] * 300)
    assert long.length == TEXT_LENGTH
    np.testing.assert_array_equal(long.words, [0] + [5] * MAX_WORDS + [1])
    unknown = SMALL.vectorize(["zorblax/NOUN", "Qux/VERB"])
    np.testing.assert_array_equal(unknown.words[:4], [0, 2, 2, 1])
    np.testing.assert_array_equal(unknown.parts_of_speech, np.full(TEXT_LENGTH, OTHER))


def test_the_text_stands_in_where_tokens_are_missing():
    assert tokens_from_text("A man's 2 arms, wave!") == ("a", "man", "s", "arms", "wave")
    assert tokens_from_text("...") == ()
    found = SMALL.vectorize(tokens_from_text("A man: wave"))
    np.testing.assert_array_equal(found.words[:5], [0, 3, 4, 7, 1])


def test_an_own_vocabulary_has_the_frequent_words():
    captions = [["b/X", "a/X", "c/X"], ["a/X", "b/X"], ["a/X", "unk/X", "unk/X", "5/X", "5/X", "/X", "/X"]]
    assert vocabulary_from_captions(captions, min_count=2).words == ("sos", "eos", "unk", "a", "b")
    assert vocabulary_from_captions(captions, min_count=1).words == ("sos", "eos", "unk", "a", "b", "c")
    assert vocabulary_from_captions([], min_count=1).words == ("sos", "eos", "unk")


def test_a_vocabulary_is_kept_in_a_file(tmp_path):
    save_vocabulary(tmp_path / "words.txt", SMALL)
    assert load_vocabulary(tmp_path / "words.txt").words == SMALL.words


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"sos\neos\nunk\na\na\n", "'a' appears twice"),
        (b"sos\neos\n", "'unk' is missing"),
        (b"", "'sos' is missing"),
        (b"sos\neos\n\nunk\n", ":3: empty"),
        (b"sos\neos\n unk\n", ":3: empty, or with spaces"),
        (b"\xff\xfe", "not UTF-8"),
        (None, "no such file"),
    ],
)
def test_a_broken_vocabulary_is_refused(tmp_path, content, said):
    path = tmp_path / "words.txt"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UserError) as caught:
        load_vocabulary(path)
    assert str(caught.value).startswith(f"{path}:") and said in str(caught.value)


def test_vectors_of_glove(tmp_path, caplog):
    path = tmp_path / "glove.txt"
    path.write_text("walk 1 2 -3\nother 0 0 0\na 4.5 1e-2 6\nwalk 9 9 9\n", encoding="utf-8")
    table = load_word_vectors(path, ("sos", "a", "walk"))
    np.testing.assert_array_equal(table[1:], np.array([[4.5, 1e-2, 6], [1, 2, -3]], np.float32))
    assert "1 of 3 words are not in it, such as 'sos'" in caplog.text
    assert np.isfinite(table[0]).all() and np.unique(table[0]).size == 3
    np.testing.assert_array_equal(load_word_vectors(path, ("a", "walk", "sos"))[2], table[0])


def test_vectors_of_a_table(tmp_path):
    table = np.arange(6, dtype=np.float64).reshape(3, 2)
    np.save(tmp_path / "table.npy", table)
    np.testing.assert_array_equal(load_word_vectors(tmp_path / "table.npy", ("a", "b", "c")), table)
    with pytest.raises(UserError, match="3 vectors for 2 words"):
        load_word_vectors(tmp_path / "table.npy", ("a", "b"))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("a 1 2\nb 1\n", ":2: expected a word and 2 numbers below 1e+06"),
        ("a\n", ":1: expected a word and some numbers below 1e+06"),
        ("a 1 nan\n", ":1: expected a word and 2 numbers below 1e+06"),
        ("a 1 x\n", ":1: expected a word and numbers"),
        ("c 1 2\n", "has none of the 2 words"),
        (None, "there is no such file"),
    ],
)
def test_broken_vectors_are_refused(tmp_path, content, said):
    path = tmp_path / "glove.txt"
    if content is not None:
        path.write_text(content, encoding="utf-8")
    with pytest.raises(UserError) as caught:
        load_word_vectors(path, ("a", "b"))
    assert str(caught.value).startswith(f"{path}:") and said in str(caught.value)


@pytest.mark.parametrize("table", [np.ones(3), np.ones((2, 2), int), np.full((2, 2), np.nan), np.ones((0, 2))])
def test_a_table_that_is_none_is_refused(tmp_path, table):
    np.save(tmp_path / "table.npy", table)
    with pytest.raises(UserError, match=r"table\.npy: "):
        load_vector_table(tmp_path / "table.npy")
    with pytest.raises(UserError, match=r"missing\.npy: there is no such file"):
        load_vector_table(tmp_path / "missing.npy")
