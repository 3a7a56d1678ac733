import pytest
from hypothesis import given
from hypothesis import strategies as st

from t2m_jax.data.captioning.lexicon import tag_words
from t2m_jax.data.texts import Caption, format_caption, load_captions, parse_caption, save_captions
from t2m_jax.data.writer import mirror
from t2m_jax.errors import UserError

LINE = "a man waves.#a/DET man/NOUN wave/VERB#0.0#0.0"


def test_parse_a_humanml3d_line():
    caption = parse_caption(LINE, source="x:1")
    assert caption == Caption("a man waves.", ("a/DET", "man/NOUN", "wave/VERB"), 0.0, 0.0)
    assert caption.whole_clip
    assert format_caption(caption) == LINE


@pytest.mark.parametrize(
    ("said", "mirrored"),
    [
        ("he waves with his R hand", "he waves with his L hand"),
        ("she turns counter clockwise", "she turns clockwise"),
        ("he left the stage", "he left the stage"),
        ("waves right away with the left hand", "waves right away with the right hand"),
    ],
)
def test_tokens_of_a_mirrored_caption_say_what_its_text_says(said, mirrored):
    assert mirror(Caption(said, tag_words(said))) == Caption(mirrored, tag_words(mirrored))


def test_tokens_of_other_taggers_keep_their_tags():
    tokens = ("he/PRON", "raise/VERB", "left/OTHER", "arm/NOUN")
    assert mirror(Caption("he raises left arm", tokens)).tokens == (*tokens[:2], "right/OTHER", tokens[3])
    leaving = Caption("he left the stage", ("he/PRON", "left/OTHER", "the/DET", "stage/NOUN"))
    assert mirror(leaving) == leaving


def test_nan_times_read_as_zero():
    assert parse_caption("he waves#he/PRON#nan#nan", source="x:1").whole_clip
    assert parse_caption("he waves#he/PRON#1.5#nan", source="x:1").start == 1.5


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("no fields", "1 fields"),
        ("five#a/DET#0.0#0.0#", "5 fields"),
        ("#a/DET#0.0#0.0", "empty"),
        ("he waves#he/PRON#zero#0.0", "'zero'"),
    ],
)
def test_broken_lines_name_file_and_line(tmp_path, line, words):
    path = tmp_path / "clip.txt"
    path.write_text(f"{LINE}\n\n{line}\n", encoding="utf-8")
    with pytest.raises(UserError, match=rf"clip\.txt:3: .*{words}"):
        load_captions(path)


def test_missing_and_binary_files_are_user_errors(tmp_path):
    with pytest.raises(UserError, match=r"none\.txt"):
        load_captions(tmp_path / "none.txt")
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UserError, match=r"binary\.txt.*UTF-8"):
        load_captions(tmp_path / "binary.txt")


@pytest.mark.parametrize("text", ["a # b", "two\nlines"])
def test_text_that_the_format_cannot_store_is_refused(text):
    with pytest.raises(UserError, match="cannot store"):
        format_caption(Caption(text))


@given(
    text=st.text(
        st.characters(codec="utf-8", exclude_characters="#\n\r", exclude_categories=("Cs", "Cc", "Zs", "Zl", "Zp")),
        min_size=1,
    ),
    times=st.tuples(st.floats(0, 100), st.floats(0, 100)),
)
def test_captions_survive_a_file(tmp_path_factory, text, times):
    path = tmp_path_factory.mktemp("texts") / "clip.txt"
    captions = (Caption(text, ("a/DET", "b/NOUN"), *times), Caption("plain"))
    save_captions(path, captions)
    assert load_captions(path) == captions
