"""What a user may type: refusals are one line that says what to do."""

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from t2m_jax.errors import UserError
from t2m_jax.text.prompts import MAX_PROMPT_LENGTH, check_prompt


@pytest.mark.parametrize(
    ("prompt", "expected"),
    [
        ("a person walks", "a person walks"),
        ("  a person\n\twalks \r\n forward ", "a person walks forward"),
        ("El niño está bailando; Mädchen & Zoë!", "El niño está bailando; Mädchen & Zoë!"),
        ("un garc\u0327on", "un garc\u0327on"),
        ("人が歩く", "人が歩く"),
        ("a person's 2 steps (left, then right) - 50% faster", "a person's 2 steps (left, then right) - 50% faster"),
        ("a" * MAX_PROMPT_LENGTH, "a" * MAX_PROMPT_LENGTH),
        ("turns 90° left", "turns 90 degrees left"),
        ("turns 90 °", "turns 90 degrees"),
        ("a person`s \u00b4step\u00b4", "a person's 'step'"),
        ("you\u2019re \u201cwalking\u201d \u2018on\u2018", "you're \"walking\" 'on'"),
        ("\ufeffa per\u200bson\u2060 walks\u200d for\u00adward", "a person walks forward"),
    ],
)
def test_words_pass_with_their_spaces_folded(prompt, expected):
    assert check_prompt(prompt) == expected


@pytest.mark.parametrize(
    ("prompt", "says"),
    [
        ("", "no words"),
        (" \t\n ", "no words"),
        ("\u3000\u00a0", "no words"),
        ("?!... -- ,", "no words"),
        ("a" * 10_000, "10,000 characters"),
        ("a person\x00 walks", "a control character (U+0000) cannot be read; leave it out"),
        ("a person \x1b[31mwalks", "a control character (U+001B)"),
        ("a person \x85walks", "U+0085"),
        ("a person walks 🙂", "prompt: the emoji or symbol 🙂 cannot be read; leave it out and describe the motion"),
        ("❤ walks", "the emoji or symbol ❤ cannot"),
        ("\u200b\u2060", "no words"),
        ("a \u202eperson", "an invisible formatting character"),
        ("a \ue000 person", "a character without a meaning (U+E000)"),
        ("a \ud800 person", "half of a character (U+D800)"),
        ("a \U000e0fff person", "a character without a meaning"),
        ("a person ^ step", "the symbol ^ cannot be read"),
    ],
)
def test_what_no_caption_has_is_refused_in_one_line(prompt, says):
    with pytest.raises(UserError) as caught:
        check_prompt(prompt)
    message = str(caught.value)
    assert message.startswith("prompt: ")
    assert says in message
    assert message.isprintable()
    assert len(message) < 200


@given(st.text(max_size=40))
def test_every_prompt_is_refused_or_folded(prompt):
    try:
        folded = check_prompt(prompt)
    except UserError as error:
        assert str(error).isprintable()
        return
    assert check_prompt(folded) == folded
    assert folded == " ".join(folded.split())
    assert not {unicodedata.category(character) for character in folded} & {"Cc", "Cf", "Cs", "Co", "Cn", "So"}
