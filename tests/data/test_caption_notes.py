"""What an audit says of captions that an evaluator reads in part or not at all."""

from t2m_jax.data.audit import caption_notes
from t2m_jax.data.texts import Caption

KNOWN = [Caption("a person walks")] * 3
NOUNS = ("person/NOUN", "a/DET")


def test_captions_that_an_evaluator_can_read_are_no_matter():
    assert caption_notes({"a": KNOWN, "b": [Caption("person", NOUNS * 10)]}, training=["a"]) == []


def test_long_captions_and_unknown_words_are_counted():
    captions = {
        "a": KNOWN,
        "long": [Caption("person", NOUNS * 150), Caption("a person")],
        "strange": [Caption("qux zorblax"), Caption("unk", ("unk/NOUN", "zorblax", "/"))],
        "untagged": [Caption("qux person")],
    }
    long, unknown = caption_notes(captions, training=["a", "missing"])
    assert long.startswith("1 captions have more than 20 words") and long.endswith("one of long)")
    assert unknown.startswith("2 captions have no word that training captions use 3 times")
    assert unknown.endswith("one of strange)")


def test_clips_without_a_caption_are_counted():
    (silent,) = caption_notes({"a": KNOWN, "mute": [], "still": ()}, training=["a", "mute"])
    assert silent.startswith("2 clips have no caption that can be read") and silent.endswith("(such as mute)")


def test_rare_words_are_not_known():
    assert len(caption_notes({"a": KNOWN[:2]}, training=["a"])) == 1
