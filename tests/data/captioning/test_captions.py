import random

import pytest

from t2m_jax.data.captioning.captions import Labels, clip_pace, true_facts, write_captions
from t2m_jax.data.captioning.grammar import Manner, Subject, sentence
from t2m_jax.data.captioning.lexicon import gerund, tag_words, third_person, words_in
from t2m_jax.data.captioning.wordings import load_wordings
from t2m_jax.data.composing.turns import held_out_compositions
from t2m_jax.evaluation.prompts.sentences import held_out_sentences
from t2m_jax.motion.facts import Facts

CONTENTS, EXCEPTIONS, STYLES, SUBJECTS, _ = load_wordings()
HELD_OUT = held_out_sentences()
FACTS = ("", "not_fast", "not_slow", "overhead", "low", "not_low", "quarter", "many")
USUAL = Facts(
    speed=1.2,
    turn=90.0,
    travel=5.0,
    forward=5.0,
    leftward=0.0,
    above_head=(0.1, 0.1),
    above_shoulder=(0.3, 0.3),
    waves=5,
)
LOW = USUAL._replace(above_head=(-0.2, -0.2), above_shoulder=(-0.05, -0.05))
VARIANTS = (
    USUAL,
    LOW,
    USUAL._replace(speed=0.1, above_head=(-0.1, -0.1)),
    USUAL._replace(speed=9.0, turn=180.0, waves=1),
)


def normal_form(text: str) -> str:
    return " ".join(words_in(text))


@pytest.fixture(scope="module")
def many_captions():
    """A few thousand captions: every content and style, each with one of the variants of facts."""
    pairs = [(content, style) for content in CONTENTS for style in STYLES]
    return {
        (content, style): write_captions(
            f"{content} {style}", Labels(content, style), VARIANTS[number % len(VARIANTS)], count=8
        )
        for number, (content, style) in enumerate(pairs)
    }


def bare(text):
    """The normal form with any subject as "someone" and any possessive as "the"."""
    words = normal_form(text)
    for subject in sorted({subject.text for subject in SUBJECTS}, key=len, reverse=True):
        if words.startswith(f"{subject} "):
            words = words.replace(subject, "someone", 1)
            break
    return " ".join("the" if word in {"his", "her", "their", "its", "your"} else word for word in words.split())


def test_every_content_has_at_least_eight_wordings():
    for content in CONTENTS.values():
        assert len({wording.predicate for wording in content.wordings}) >= 8
        assert {wording.needs for wording in content.wordings} <= set(FACTS), "a fact that nobody measures"
    for wordings in EXCEPTIONS.values():
        assert len(set(wordings)) >= 8


def test_every_word_of_every_wording_has_a_tag():
    for content in CONTENTS.values():
        for wording in content.wordings:
            for form in ("present", "progressive", "imperative", "gerund", "begins"):
                text = sentence(wording.predicate, SUBJECTS[0], form=form, side=content.side)
                tag_words(text, strict=True)
                assert "{" not in text and "[" not in text
    for style in STYLES.values():
        for text, _ in (*style.manners, *style.subjects):
            tag_words(text, strict=True)


def test_captions_of_a_clip_are_distinct_and_depend_on_its_name_only():
    labels = Labels("wave-left-hand", "active")
    captions = write_captions("clip", labels, USUAL)
    assert len({caption.text for caption in captions}) == 6
    random.seed(1)
    assert write_captions("clip", labels, USUAL) == captions
    assert write_captions("another", labels, USUAL) != captions


def test_captions_carry_tags_and_no_separator(many_captions):
    for captions in many_captions.values():
        for caption in captions:
            assert "#" not in caption.text
            assert caption.tokens
            assert all(token.count("/") == 1 for token in caption.tokens)


def test_sides_are_those_of_the_content(many_captions):
    for (content, _), captions in many_captions.items():
        words = {word for caption in captions for word in words_in(caption.text)}
        side = CONTENTS[content].side
        if side in ("left", "right"):
            assert {"left": "right", "right": "left"}[side] not in words
        if side == "":
            assert not words & {"left", "right"}


def test_captions_say_what_was_measured():
    slow, fast = USUAL._replace(speed=0.5), USUAL._replace(speed=1.8)
    labels = Labels("walk", "normal")
    assert clip_pace(labels, slow) == "slow"
    assert clip_pace(labels, fast) == "fast"
    texts = {
        facts: " ".join(c.text for n in range(40) for c in write_captions(f"{n}", labels, facts))
        for facts in (slow, fast)
    }
    assert "slowly" in texts[slow] and "quickly" not in texts[slow] and "stride" not in texts[slow]
    assert "quickly" in texts[fast] and "slowly" not in texts[fast] and "stroll" not in texts[fast]


def test_a_hand_below_the_shoulder_is_never_said_to_go_overhead():
    labels = Labels("raise-up-left-hand", "normal")
    assert "low" in true_facts(labels, LOW)
    for number in range(50):
        for caption in write_captions(f"{number}", labels, LOW):
            assert not {"head", "sky", "ceiling", "air"} & set(words_in(caption.text)), caption.text


def test_a_turn_that_is_no_quarter_is_not_called_ninety_degrees():
    labels = Labels("walk-turn-left", "normal")
    for number in range(50):
        for caption in write_captions(f"{number}", labels, USUAL._replace(turn=150.0)):
            assert "ninety" not in caption.text and "90" not in caption.text and "quarter" not in caption.text


def test_held_out_sentences_are_new_but_their_words_are_not(many_captions):
    captions = {normal_form(caption.text) for group in many_captions.values() for caption in group}
    vocabulary = {word for text in captions for word in text.split()}
    predicates = {
        bare(sentence(wording.predicate, Subject("someone", "the"), form=form, side=content.side, limb=limb))
        for content in CONTENTS.values()
        for wording in content.wordings
        for form in ("present", "progressive", "imperative", "gerund", "begins")
        for limb in ("hand", "arm")
    }
    assert len(HELD_OUT) == 11
    for sentences in HELD_OUT.values():
        forms = {normal_form(text) for text in sentences}
        assert len(forms) == len(sentences) >= 20
        assert not forms & captions
        assert not {bare(text) for text in sentences} & predicates
        assert {word for text in forms for word in text.split()} <= vocabulary


def test_no_caption_asks_for_two_actions_as_the_composed_sentences_do(many_captions):
    captions = {normal_form(caption.text) for group in many_captions.values() for caption in group}
    assert not {normal_form(text) for sentences in held_out_compositions().values() for text in sentences} & captions


@pytest.mark.parametrize(
    ("form", "expected"),
    [
        ("present", "a tired man raises his left hand and lowers it"),
        ("progressive", "a tired man is raising his left hand and lowering it"),
        ("begins", "a tired man begins to raise his left hand and lower it"),
    ],
)
def test_sentence_forms(form, expected):
    subject = Subject("a man", "his")
    text = sentence(
        "[raise] {limb} and [lower] {it}", subject, form=form, side="left", manner=Manner("tired", "adjective")
    )
    assert text == expected


def test_imperative_and_gerund_have_no_subject():
    subject = Subject("an adult", "their")
    assert sentence("[wave] {limb}", subject, form="imperative", side="both") == "wave both hands"
    assert sentence("[wave] {limb}", subject, form="imperative", side="left", limb="arm") == "wave your left arm"
    assert (
        sentence("[run] fast", subject, form="gerund", manner=Manner("quickly", "before_verb"))
        == "quickly running fast"
    )


def test_adjectives_take_the_right_article():
    assert (
        sentence("[walk]", Subject("a man", "his"), form="present", manner=Manner("old", "adjective"))
        == "an old man walks"
    )
    assert (
        sentence("[walk]", Subject("an adult", "their"), form="present", manner=Manner("sad", "adjective"))
        == "a sad adult walks"
    )
    assert (
        sentence("[walk]", Subject("someone", "their"), form="present", manner=Manner("sad", "adjective"))
        == "someone walks"
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a man kicks with his left leg", "a/DET man/NOUN kick/VERB with/ADP his/DET left/ADJ leg/NOUN"),
        ("turning to the left.", "turn/VERB to/ADP the/DET left/NOUN"),
        ("he begins to walk", "he/PRON begin/VERB to/PART walk/VERB"),
        ("she turns left", "she/PRON turn/VERB left/ADV"),
        ("give a wave", "give/VERB a/DET wave/NOUN"),
        ("walk back 90 degrees", "walk/VERB back/ADV degree/NOUN"),
        ("counter-clockwise", "counterclockwise/ADV"),
    ],
)
def test_tags_follow_humanml3d(text, expected):
    assert " ".join(tag_words(text)) == expected


def test_unknown_words_are_guessed_unless_strict():
    assert tag_words("zorbling oddly over xylophones") == ("zorbl/VERB", "oddly/ADV", "over/ADV", "xylophone/NOUN")
    with pytest.raises(KeyError):
        tag_words("xylophone", strict=True)


@pytest.mark.parametrize(
    ("base", "third", "ing"),
    [
        ("walk", "walks", "walking"),
        ("wave", "waves", "waving"),
        ("run", "runs", "running"),
        ("carry", "carries", "carrying"),
        ("go", "goes", "going"),
    ],
)
def test_verb_forms(base, third, ing):
    assert (third_person(base), gerund(base)) == (third, ing)
