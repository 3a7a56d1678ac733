"""What the fields of a request may be."""

import pytest

from t2m_jax.errors import UserError
from t2m_jax.serving.requests import decode_base64, request_from_json

GOOD = {"captions": ["a person walks"]}


def test_a_request_with_one_sentence_is_enough():
    request = request_from_json(GOOD)
    assert request.captions == ("a person walks",) and request.num_samples == 1 and request.is_plain


@pytest.mark.parametrize(
    "fields",
    [
        {"captions": ["a person walks", "a person waves"]},
        {"seconds": 2},
        {"motion": "AAAA", "edit": "continue"},
    ],
)
def test_chains_lengths_and_edits_are_not_plain(fields):
    assert not request_from_json(GOOD | fields).is_plain


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"captions": []}, "captions: give 1 to 20"),
        ({"captions": ["a person walks"] * 21}, "captions: give 1 to 20"),
        ({"captions": [""]}, "prompt: '' has no words"),
        ({"captions": ["\u202e walks"]}, "an invisible formatting character"),
        ({"captions": "a person walks"}, "captions: expected a list"),
        ({"caption": "a person walks"}, "unknown key 'caption'; did you mean 'captions'"),
        ({"seed": -1}, "seed"),
        ({"seed": 2**32}, "seed"),
        ({"seed": 1.5}, "seed"),
        ({"num_samples": 0}, "num_samples: 0 is not a whole number from 1 to 8"),
        ({"num_samples": 9}, "num_samples: 9 is not a whole number from 1 to 8"),
        ({"num_samples": True}, "num_samples: expected"),
        ({"seconds": 0}, "seconds: 0 is not a number above 0, up to 60"),
        ({"seconds": float("inf")}, "seconds: inf is not"),
        ({"seconds": float("nan")}, "seconds: expected"),
        ({"captions": ["a person walks"] * 11, "seconds": 60}, "seconds: all motions together"),
        ({"guidance_scale": -1}, "guidance_scale: -1 is not a number from 0 to 20"),
        ({"strength": 1.5}, "strength: 1.5 is not a number from 0 to 1"),
        ({"variety": "wild"}, "variety: expected one of"),
        ({"edit": "redo"}, "edit: goes together with motion"),
        ({"motion": "AAAA"}, "edit: goes together with motion"),
        ({"motion": "AAAA", "edit": "redo"}, "span: goes together"),
        ({"motion": "AAAA", "edit": "vary", "span": [1, 2]}, "span: goes together"),
        ({"motion": "AAAA", "edit": "vary", "seconds": 2}, "edit: 'vary' takes one sentence"),
        ({"motion": "AAAA", "edit": "vary", "motion_format": "exe"}, "motion_format: expected one of"),
    ],
)
def test_what_cannot_be_used_is_named(fields, message):
    with pytest.raises(UserError, match=r"^request: ") as caught:
        request_from_json(GOOD | fields)
    assert message in str(caught.value)


@pytest.mark.parametrize("data", [None, [], "text", 3])
def test_a_request_is_an_object(data):
    with pytest.raises(UserError, match="request"):
        request_from_json(data)


def test_only_base64_is_decoded():
    assert decode_base64("AAEC") == b"\x00\x01\x02"
    for text in ("A", "é", "AA EC", "%%%%"):
        with pytest.raises(UserError, match="is not base64"):
            decode_base64(text)
