import random
import re

import pytest

from t2m_jax.data.captioning.captions import Labels
from t2m_jax.data.captioning.lexicon import read_words
from t2m_jax.data.captioning.sequences import (
    write_count_captions,
    write_duration_captions,
    write_then_captions,
    write_while_captions,
)
from t2m_jax.data.captioning.wordings import load_wordings
from tests.data.captioning.test_captions import LOW, USUAL

CONTENTS = load_wordings().contents
WALK = Labels("walk", "normal")
CLAP = Labels("clap", "normal")
PATTERNS = read_words("t2m_jax.data.captioning", "sequences")["patterns"]


def said(caption):
    """What a caption says, in basic forms and without typing mistakes."""
    return " ".join(token.partition("/")[0] for token in caption.tokens)


def test_sequences_are_different_and_repeatable():
    for write in (
        lambda generator: write_then_captions([WALK, CLAP], facts=[USUAL, USUAL], count=60, generator=generator),
        lambda generator: write_while_captions(WALK, CLAP, count=60, generator=generator),
        lambda generator: write_count_captions(CLAP, 3, count=60, generator=generator),
        lambda generator: write_duration_captions(WALK, 5.0, count=60, generator=generator),
    ):
        captions = write(random.Random(0))
        assert len({caption.text for caption in captions}) == 60
        assert write(random.Random(0)) == captions != write(random.Random(1))
        for caption in captions:
            assert not set("{}[]#") & set(caption.text), caption.text


@pytest.mark.parametrize("kind", ["then_two", "then_stops", "then_three"])
def test_patterns_say_in_which_order_things_are_done(kind):
    for text in (text for texts in PATTERNS[kind].values() for text in texts):
        places = [int(place) for place in re.findall(r"{[a-z]*(\d)}", text)]
        assert sorted(places) == list(range(3 if kind == "then_three" else 2)), text
        # What is said later is done later, unless a word turns it around.
        last_first = re.search(r"(?<!first )\bafter ({again}|{\w*0})|preceded by", text) and not text.startswith(
            "after"
        )
        first_last = text.startswith("before")
        assert (places == sorted(places)) != bool(last_first or first_last), text


def test_both_actions_are_said_in_their_order():
    pieces = [Labels("clap", "normal"), Labels("jump", "normal")]
    for caption in write_then_captions(pieces, facts=[USUAL, USUAL], count=300, generator=random.Random(0)):
        text = re.sub("after that|shortly after|after have|afterward", "", said(caption))
        first, second = (re.search(stems, text) for stems in (CLAPPING, JUMPING))
        assert first and second, text
        between = text[min(first.end(), second.end()) : max(first.start(), second.start())]
        opening = text[: min(first.start(), second.start())]
        turned = bool(re.search("after|preced", between)) or "before" in opening
        assert (first.start() < second.start()) != turned, text


CLAPPING = r"clap|applau|palm|big hand|slap|smack|hand together|approval|noise"
JUMPING = r"jump|bounce|spring|push off|lift off|off the ground|go up"


def test_no_part_of_a_sequence_has_another_side():
    left, right = (Labels(f"wave-{side}-hand", "active") for side in ("left", "right"))
    for caption in write_while_captions(WALK, left, count=200, generator=random.Random(2)):
        assert "left" in said(caption).split() and "right" not in said(caption).split(), caption
        assert "stand" not in said(caption), "the legs walk"
    for caption in write_then_captions([WALK, right], facts=[USUAL, USUAL], count=200, generator=random.Random(3)):
        assert "right" in said(caption).split() and "left" not in said(caption).split(), caption


def test_low_hands_are_mentioned_in_turn():
    pieces = [WALK, Labels("raise-up-both-hands", "elderly")]
    low = re.compile("chest|shoulder|little|slightly|halfway|low|a bit|small|front of the body")
    for caption in write_then_captions(pieces, facts=[USUAL, LOW], count=100, generator=random.Random(4)):
        assert low.search(said(caption)), caption


@pytest.mark.parametrize(
    ("times", "words"), [(1, "once|one|1|single"), (3, "three|3|thrice|few"), (5, "five|5|several|many")]
)
def test_numbers_are_right(times, words):
    others = re.compile(r"\b(two|twice|2|2x|x2|four|4|six|seven|couple)\b")
    right = 0
    for caption in write_count_captions(Labels("jump", "normal"), times, count=150, generator=random.Random(times)):
        text = re.sub("player (one|two|1|2)|both feet|both legs", "", caption.text.lower())
        right += bool(re.search(words, text))
        assert not others.search(text), text
    assert right >= 145, "all but some with a typing mistake in the number"


@pytest.mark.parametrize(("seconds", "words"), [(5.1, "5|five"), (2.4, "2.5"), (12.0, "12|twelve"), (30.2, "30")])
def test_durations_are_right(seconds, words):
    captions = write_duration_captions(WALK, seconds, count=100, generator=random.Random(7))
    right = [re.search(rf"\b({words}) ?(full )?s", caption.text.lower()) for caption in captions]
    assert sum(map(bool, right)) >= 95, "all but some with a typing mistake in the number"


@pytest.mark.slow
def test_every_content_can_be_in_every_sequence():
    for content in CONTENTS:
        labels = Labels(content, "normal")
        assert len(write_count_captions(labels, 2, count=20, generator=random.Random(5))) == 20
        assert len(write_duration_captions(labels, 4.0, count=20, generator=random.Random(5))) == 20
        assert len(write_while_captions(WALK, labels, count=20, generator=random.Random(5))) == 20
