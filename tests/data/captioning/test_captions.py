import random
import re
from collections import defaultdict

import pytest

from t2m_jax.data.captioning.captions import CAPTIONS, Labels, clip_pace, says_pace, true_facts, write_captions
from t2m_jax.data.captioning.grammar import Frame, Manner, Subject, clause, sentence
from t2m_jax.data.captioning.held_out import fingerprint, held_out_fingerprints
from t2m_jax.data.captioning.lexicon import TAGS, inflect, known_words, tag_words, words_in
from t2m_jax.data.captioning.wordings import load_frames, load_wordings
from t2m_jax.evaluation.prompts.sentences import held_out_sentences
from t2m_jax.motion.facts import Facts
from tests.data.captioning.held_out import find_sentences

CONTENTS, EXCEPTIONS, STYLES, _, _ = load_wordings()
FRAMES = load_frames()
VERB_FORMS = ("present", "progressive", "base", "past", "perfect", "imperative", "gerund")
HELD_OUT = held_out_sentences()
FACTS = ("", "not_fast", "not_slow", "overhead", "low", "not_low", "quarter", "many", "counted")
USUAL = Facts(
    speed=1.2,
    turn=90.0,
    travel=5.0,
    forward=5.0,
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
    """The normal form with any usual subject as "someone" and any possessive as "the"."""
    words = normal_form(text)
    for subject in sorted({subject.text for subject in FRAMES.usual_subjects}, key=len, reverse=True):
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


def test_verbs_of_wordings_are_in_the_vocabulary_and_no_slot_is_left():
    for content in CONTENTS.values():
        for wording in content.wordings:
            verbs = set(re.findall(r"\[(\w+)\]", wording.predicate))
            assert verbs <= known_words(), wording
            for form in VERB_FORMS if wording.nominal_form is None else (wording.nominal_form,):
                text = clause(wording.predicate, Subject("a man", "his"), form=form, side=content.side)
                assert not set("[]{}") & set(text.replace("{number}", "")), wording


def test_captions_of_a_clip_are_distinct_and_depend_on_its_name_only():
    labels = Labels("wave-left-hand", "active")
    captions = write_captions("clip", labels, USUAL)
    assert len({caption.text for caption in captions}) == CAPTIONS
    random.seed(1)
    assert write_captions("clip", labels, USUAL) == captions
    assert write_captions("another", labels, USUAL) != captions


def neutral_texts():
    """All that is said around an action."""
    surroundings = [text for texts in FRAMES.surroundings.values() for text in texts]
    subjects = [subject.text for subject in (*FRAMES.usual_subjects, *FRAMES.other_subjects)]
    return [*surroundings, *subjects, *FRAMES.looks, *FRAMES.nouns]


def test_captions_are_wide_in_what_does_not_matter():
    assert len(set(FRAMES.other_subjects)) >= 300 and len(set(FRAMES.nouns)) >= 1000
    assert sum(len(set(texts)) for texts in FRAMES.surroundings.values()) >= 250
    assert sum(len(set(frames)) for frames in FRAMES.by_form.values()) >= 40


def test_what_is_around_an_action_names_no_action_side_order_number_or_pace():
    actions = {word for content in CONTENTS for word in content.split("-")} - {
        "direct",
        "short",
        "long",
        "up",
        "down",
        "pick",
    }
    actions |= {
        "arm",
        "arms",
        "chair",
        "crowbar",
        "fist",
        "hand",
        "hands",
        "head",
        "jog",
        "leg",
        "march",
        "spin",
        "sprint",
    }
    order = {"left", "right", "then", "before", "after", "while", "until", "meanwhile"}
    numbers = {"once", "twice", "two", "three", "four", "five", "six", "times", "seconds"}
    inflected = {inflect(action, tag) for action in actions for tag in TAGS}
    for text in neutral_texts():
        words = set(words_in(text.removeprefix("player two")))
        assert not words & (actions | inflected | order | numbers), text
        assert not says_pace(text), text


def test_every_pace_is_known_from_its_words():
    manners = {pace: [*load_wordings().extremes[pace], *load_wordings().extremes[f"very_{pace}"]] for pace in PACES}
    for content in CONTENTS.values():
        for pace in PACES:
            manners[pace] += content.paces[pace]
    for pace, other in (PACES, PACES[::-1]):
        for manner in manners[pace]:
            basic = " ".join(token.partition("/")[0] for token in tag_words(manner.text.replace("{poss}", "his")))
            assert says_pace(basic, pace) and not says_pace(basic, other), manner


PACES = ("slow", "fast")


def test_no_wording_is_said_of_two_actions():
    groups = defaultdict(set)
    for content, entry in CONTENTS.items():
        for wording in entry.wordings:
            groups[wording.predicate.replace("{side}", entry.side)].add(ALIKE.get(content, content))
    assert not {text: found for text, found in groups.items() if len(found) > 1}


# Contents that are the same but for the side or the data set, and goodbyes, which are waves.
ALIKE = {name: "wave" for name in CONTENTS if name.startswith(("wave", "bye"))}
ALIKE |= {name: "raise" for name in CONTENTS if name.startswith("raise")}
ALIKE |= {"dance-short": "dance", "dance-long": "dance"}


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


def test_test_sentences_are_known_and_no_wording_is_one():
    missing = {text for text in find_sentences() if fingerprint(text) not in held_out_fingerprints()}
    assert not missing, "run python -m tests.data.captioning.held_out"
    predicates = {
        bare(sentence(frame, wording.predicate, Subject("someone", "the"), side=content.side, limb=limb))
        for content in CONTENTS.values()
        for wording in content.wordings
        for form in (VERB_FORMS if wording.nominal_form is None else (wording.nominal_form,))
        for frame in FRAMES.by_form.get(form, ())[:1]
        for limb in ("hand", "arm")
    }
    assert len(HELD_OUT) == 11
    for sentences in HELD_OUT.values():
        assert len({normal_form(text) for text in sentences}) == len(sentences) >= 20
        assert not {bare(text) for text in sentences} & predicates


def test_no_caption_is_a_test_sentence(monkeypatch):
    before = write_captions("clip", Labels("walk", "normal"), USUAL, count=24)
    texts = {fingerprint(" ".join(words_in(caption.text))) for caption in before[:9]}
    monkeypatch.setattr("t2m_jax.data.captioning.captions.held_out_fingerprints", lambda: texts)
    after = write_captions("clip", Labels("walk", "normal"), USUAL, count=24)
    assert not {fingerprint(caption.text) for caption in after} & texts


@pytest.mark.parametrize(
    ("frame", "expected"),
    [
        (Frame("{subject} {body}", "present"), "a tired man raises his left hand and lowers it"),
        (Frame("{subject} {be} {body}", "progressive"), "a tired man is raising his left hand and lowering it"),
        (Frame("can you make {object} {body}?", "base"), "can you make a tired man raise his left hand and lower it?"),
        (Frame("{subject} {has} {body}", "perfect"), "a tired man has raised his left hand and lowered it"),
    ],
)
def test_sentence_forms(frame, expected):
    manner = Manner("tired", "adjective")
    predicate = "[raise] {limb} and [lower] {it}"
    assert sentence(frame, predicate, Subject("a man", "his"), side="left", manner=manner) == expected


@pytest.mark.parametrize(
    ("subject", "expected"),
    [
        (Subject("they", "their"), "they run"),
        (Subject("I", "my"), "I run"),
        (Subject("my uncle", "his"), "my uncle runs"),
    ],
)
def test_verbs_agree_with_their_subjects(subject, expected):
    assert sentence(Frame("{subject} {body}", "present"), "[run]", subject) == expected


@pytest.mark.parametrize(
    ("subject", "again", "indefinite"),
    [
        (Subject("the guard", "their"), "the guard", "a guard"),
        (Subject("a guard", "their"), "the guard", "a guard"),
        (Subject("the engineer", "their"), "the engineer", "an engineer"),
        (Subject("my uncle", "his"), "he", "someone"),
        (Subject("Maria", "her"), "she", "someone"),
        (Subject("the robot", "its"), "it", "a robot"),
        (Subject("someone", "their"), "someone", "someone"),
        (Subject("I", "my"), "I", "someone"),
    ],
)
def test_subjects_are_called_again_and_introduced(subject, again, indefinite):
    assert (subject.again().text, subject.indefinite()) == (again, indefinite)


def test_imperative_and_gerund_have_no_subject():
    subject = Subject("an adult", "their")
    assert clause("[wave] {limb}", subject, form="imperative", side="both") == "wave both hands"
    assert clause("[wave] {limb}", subject, form="imperative", side="left", limb="arm") == "wave your left arm"
    quickly = Manner("quickly", "before_verb")
    assert clause("[run] fast", subject, form="gerund", manner=quickly) == "quickly running fast"


def test_nominal_wordings():
    slow = Manner("slow", "attribute")
    assert clause("a walk with {limb} up", SOMEONE, form="noun", side="left", manner=slow) == (
        "a slow walk with the left hand up"
    )
    assert clause("{limb} {be} raised", SOMEONE, form="passive", side="both") == "both hands are raised"
    by = Frame("{body} by {object}", "passive")
    assert sentence(by, "{limb} {be} raised", Subject("he", "his"), side="left") == "the left hand is raised by him"


SOMEONE = Subject("someone", "their")


def test_adjectives_take_the_right_article():
    frame = Frame("{subject} {body}", "present")
    for subject, adjective, expected in (
        ("a man", "old", "an old man walks"),
        ("an adult", "sad", "a sad adult walks"),
        ("someone", "sad", "someone walks"),
    ):
        manner = Manner(adjective, "adjective")
        assert sentence(frame, "[walk]", Subject(subject, "his"), manner=manner) == expected


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


def test_tags_of_unknown_words_are_guessed():
    assert tag_words("zorbling oddly over xylophones") == ("zorbl/VERB", "oddly/ADV", "over/ADV", "xylophone/NOUN")


@pytest.mark.parametrize(
    ("base", "third", "ing", "ed", "done"),
    [
        ("walk", "walks", "walking", "walked", "walked"),
        ("wave", "waves", "waving", "waved", "waved"),
        ("run", "runs", "running", "ran", "run"),
        ("carry", "carries", "carrying", "carried", "carried"),
        ("go", "goes", "going", "went", "gone"),
        ("lie", "lies", "lying", "lay", "lain"),
        ("hop", "hops", "hopping", "hopped", "hopped"),
    ],
)
def test_verb_forms(base, third, ing, ed, done):
    assert [inflect(base, tag) for tag in TAGS] == [third, ing, ed, done]


def test_some_captions_say_only_what_somebody_does():
    """These are what people type first; a model that never read them gives anything for them."""
    texts = [
        normal_form(caption.text)
        for number in range(40)
        for caption in write_captions(f"walk {number}", Labels("walk", "normal"), USUAL)
    ]
    plain = {f"{subject} walks{rest}" for subject in ("a person", "a man", "a woman") for rest in ("", " forward")}
    assert {"a person walks", "a person walks forward"} <= set(texts)
    assert 0.005 < sum(text in plain for text in texts) / len(texts) < 0.2
