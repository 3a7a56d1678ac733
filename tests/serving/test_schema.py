"""What the fields of requests may be, and that they are those of the library's records."""

import json

import pytest

from t2m_jax.errors import UserError
from t2m_jax.motion.changes import Changes
from t2m_jax.records import fields_of
from t2m_jax.sampling.request import MotionRequest, SamplingOptions
from t2m_jax.serving.schema import (
    LIMITS,
    PYTHON_ONLY,
    CharacterParameters,
    FileBody,
    FileParameters,
    KeepParameters,
    MotionBody,
    SceneParameters,
    check_lengths,
    decode_base64,
    motion_request,
    read_body,
    read_parameters,
)
from t2m_jax.text.coverage import Knowledge
from tests.export.conftest import walk  # noqa: F401 - a fixture

KNOWN = Knowledge(frozenset(), ("walk", "wave"))
GOOD = {"captions": ["a person walks"]}


def request_of(data, start=None) -> MotionRequest:
    return motion_request(read_body(MotionBody, json.dumps(data).encode()), start)


def names_of(*records) -> list[str]:
    return [field.name for record in records for field in fields_of(record)]


def test_a_request_has_every_field_of_the_record():
    expected = {*names_of(MotionRequest), "start_format"} - set(PYTHON_ONLY)
    assert set(MotionBody.model_fields) == expected
    assert set(LIMITS) <= expected | set(names_of(Changes))


def test_files_can_be_changed_in_every_way_of_the_record():
    assert set(FileParameters.model_fields) == {"format", "names", "units", "root_bone", "camera", *names_of(Changes)}
    assert set(SceneParameters.model_fields) == {"format", "rig", "name", "rig_name", "split", *names_of(Changes)}


@pytest.mark.parametrize("model", [MotionBody, FileParameters, SceneParameters])
def test_every_field_is_described(model):
    assert all(field.description.endswith(".") for field in model.model_fields.values())


def test_a_request_with_one_sentence_is_enough():
    request = request_of(GOOD)
    assert request.captions == ("a person walks",) and request.num_samples == 1
    assert request.options == SamplingOptions()


def test_a_seed_is_drawn_if_none_is_given():
    assert len({request_of(GOOD | {"seed": seed}).seed for seed in (None, None, 5)}) == 3
    assert request_of(GOOD | {"seed": 5}).seed == 5


def test_targets_are_texts():
    first, second = request_of(GOOD | {"targets": "2 right_wrist=-0.3,1.7,0.2; 4 root=1,3"}).targets
    assert (first.joint, first.place, second.seconds) == ("right_wrist", (-0.3, 1.7, 0.2), 4.0)
    assert request_of(GOOD | {"targets": None}).targets == request_of(GOOD | {"targets": " "}).targets == ()
    for wrong in ("2 right_wrist", 3, ["2 root=0,0"]):
        with pytest.raises(UserError, match=r"^request: targets: "):
            request_of(GOOD | {"targets": wrong})


def test_all_sampling_options_reach_the_record():
    given = {"temperature": 0.7000000000000001, "top_p": 0.9, "guidance_scale": 2, "stop_rule": "sampled", "raw": True}
    expected = SamplingOptions(temperature=0.7, top_p=0.9, guidance_scale=2.0, stop_rule="sampled", raw=True)
    assert request_of(GOOD | given).options == expected
    assert request_of(GOOD | {"top_k": 20}).options == SamplingOptions(top_k=20)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"captions": [""]}, "captions: '' has no words"),
        ({"captions": ["a person walks", "a person waves", "?!"]}, "captions: sentence 3: '?!' has no words"),
        ({"captions": ["\u202e walks"]}, "an invisible formatting character"),
        ({"captions": "a person walks"}, "request: captions: input should be a valid array, not 'a person walks'"),
        ({"caption": "a person walks"}, "request: unknown field 'caption'; did you mean 'captions'?"),
        ({"variety": "low"}, "request: unknown field 'variety'; known: captions, start, "),
        ({"seed": -1}, "request: seed: input should be greater than or equal to 0, not -1"),
        ({"seed": 2**32}, "request: seed: "),
        ({"seed": 1.5}, "request: seed: "),
        ({"num_samples": 0}, "request: num_samples: "),
        ({"num_samples": 9}, "request: num_samples: input should be less than or equal to 8, not 9"),
        ({"num_samples": True}, "request: num_samples: input should be a valid integer, not True"),
        ({"seconds": 0}, "request: seconds: input should be greater than 0, not 0"),
        ({"seconds": float("inf")}, "request: seconds: input should be a finite number, not inf"),
        ({"seconds": float("nan")}, "request: seconds: input should be a finite number, not nan"),
        ({"guidance_scale": -1}, "request: guidance_scale: "),
        ({"strength": 1.5}, "request: strength: "),
        ({"temperature": 0.75}, "request: temperature: input should be a multiple of 0.1, not 0.75"),
        ({"top_k": 5}, "request: top_k: input should be a multiple of 10, not 5"),
        ({"top_p": 0.25}, "request: top_p: input should be a multiple of 0.1, not 0.25"),
        ({"top_k": 20, "top_p": 0.5}, "top-k and top-p exclude each other"),
        ({"stop_rule": "never"}, "request: stop_rule: input should be 'argmax', 'threshold' or 'sampled', not 'never'"),
        ({"span": [1, 2]}, "span: changes a motion; give it as start"),
        ({"seed": 2.0**32}, "request: seed: input should be less than or equal to 4294967295, not 4294967296"),
        ({"top_k": 15.0}, "request: top_k: input should be a multiple of 10, not 15"),
        ({"start_format": "bvh"}, "start_format: is the format of start; give start, or leave it out"),
        ({"start_format": "npz", "start": None}, "start_format: is the format of start; give start"),
        ({"strength": 0.5}, "strength: changes a motion; give it as start"),
        ({"start": "%%%"}, "request: start: is not base64"),
        ({"start": 3}, "request: start: is not base64"),
        (
            {"start_format": "exe"},
            "request: start_format: input should be 'npz', 'bvh', 'glb', 'vrma' or 'npy', not 'exe'",
        ),
    ],
)
def test_what_cannot_be_used_is_named(fields, message):
    with pytest.raises(UserError) as caught:
        request_of(GOOD | fields)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("model", "fields", "message"),
    [
        (MotionBody, {"captions": []}, "captions: input should have at least 1 item, not 0"),
        (MotionBody, {"captions": ["a person walks"] * 21}, "captions: input should have at most 20 items, not 21"),
        (MotionBody, GOOD | {"span": [1, 2, 3]}, "span: input should have at most 2 items, not 3"),
        (FileBody, {"motions": []}, "motions: input should have at least 1 item, not 0"),
        (FileBody, {"motions": ["AAEC"] * 33}, "motions: input should have at most 32 items, not 33"),
    ],
)
def test_a_number_of_items_is_told_in_the_words_of_json(model, fields, message):
    with pytest.raises(UserError) as caught:
        read_body(model, json.dumps(fields).encode())
    assert str(caught.value) == f"request: {message}"


def test_whole_numbers_may_have_a_point():
    """JSON Schema calls 1.0 an integer, and some programs write all numbers so."""
    found = request_of(GOOD | {"seed": 7.0, "num_samples": 2.0, "top_k": 2e1})
    assert (found.seed, found.num_samples, found.options.top_k) == (7, 2, 20)
    assert all(type(number) is int for number in (found.seed, found.num_samples, found.options.top_k))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"captions": ["a person walks"] * 11, "seconds": 60},
            "seconds: all motions together would be longer",
        ),
        ({"captions": ["a person walks for ten minutes"]}, "seconds: 600 for a sentence are more than 60"),
        ({"captions": ["walks for a minute"] * 11}, "seconds: all motions together"),
        ({"captions": ["walks for a minute, then waves for 500 seconds"]}, "seconds: 500 for a sentence are more"),
    ],
)
def test_lengths_in_words_have_limits_too(fields, message):
    with pytest.raises(UserError, match=message):
        check_lengths(request_of(GOOD | fields).in_turn(KNOWN))


def test_a_length_that_is_divided_among_actions_may_reach_the_limit():
    """Seventeen parts of 600 seconds add up to a little more, in floating-point numbers."""
    captions = ["walks, then waves"] * 7 + ["walks"] * 3
    check_lengths(request_of(GOOD | {"captions": captions, "seconds": 60}).in_turn(KNOWN))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"span": [1, 2], "strength": 0.5}, "span: excludes strength"),
        ({"strength": 0.5, "seconds": 2}, "strength: excludes seconds"),
        ({"strength": 0.5, "targets": "1 root=0,0"}, "or a span to redo; leave out a variation"),
        ({"span": [2, 1]}, "span: 2 to 1 s ends before it begins"),
        ({"candidates": 2}, "candidates: is only for targets or a span to redo"),
        ({"span": [1, 2], "candidates": 2, "num_samples": 3}, "num-samples: 3 motions cannot be chosen from 2"),
    ],
)
def test_changes_of_a_motion_that_do_not_go_together(walk, fields, message):  # noqa: F811
    with pytest.raises(UserError) as caught:
        request_of(GOOD | fields, walk)
    assert message in str(caught.value)


@pytest.mark.parametrize("data", [b"null", b"[]", b'"text"', b"3", b"{", b"[" * 100_000, b'{"captions": ["\\ud800"]}'])
def test_a_request_is_an_object(data):
    with pytest.raises(UserError, match=r"^request: "):
        read_body(MotionBody, data)


def test_only_base64_is_decoded():
    assert decode_base64("AAEC") == b"\x00\x01\x02"
    for text in ("A", "é", "AA EC", "%%%%", None):
        with pytest.raises(ValueError, match="is not base64"):
            decode_base64(text)
    with pytest.raises(UserError, match=r"^request: motions\.1: is not base64"):
        read_body(FileBody, b'{"motions": ["AAEC", "%"]}')


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ({"format": "exe"}, "parameters: format: input should be 'bvh', "),
        ({"fps": "25.5"}, "parameters: fps: input should be a multiple of 1"),
        ({"fps": "1000"}, "parameters: fps: input should be less than or equal to 120"),
        ({"fps": "x"}, "parameters: fps: input should be a valid number"),
        ({"loop": "maybe"}, "parameters: loop: input should be a valid boolean"),
        ({"begin": "nan"}, "parameters: begin: input should be a finite number"),
        ({"speed": "11"}, "parameters: speed: input should be less than or equal to 10"),
        ({"turn": "721"}, "parameters: turn: input should be less than or equal to 720"),
        ({"path": "0,0"}, "parameters: path: 1 point; give two or more"),
        ({"path": "0,0 1,2 3"}, "parameters: path: point 3 needs two numbers, x and z in meters, not 1"),
        ({"path": "/etc/passwd"}, "parameters: path: '/etc/passwd' is not points of two numbers"),
        ({"file": "/etc/passwd"}, "parameters: unknown field 'file'; known: format, names, "),
        ({"names": "../x"}, "parameters: names: input should be 'lafan1', "),
    ],
)
def test_parameters_are_checked(query, message):
    with pytest.raises(UserError) as caught:
        read_parameters(FileParameters, query.items())
    assert message in str(caught.value)


@pytest.mark.parametrize("model", [FileParameters, SceneParameters, CharacterParameters, KeepParameters])
def test_a_parameter_is_given_once(model):
    for name in (*model.model_fields, "other"):
        with pytest.raises(UserError, match=rf"^parameters: {name}: is given 2 times; give it once$"):
            read_parameters(model, [(name, "2"), ("x", "1"), (name, "2")])


def test_parameters_become_changes():
    query = {"path": "0,0 1,2", "mirror": "1", "loop": "false", "speed": "2"}
    assert read_parameters(SceneParameters, query.items()) == {
        "path": ((0, 0), (1, 2)),
        "mirror": True,
        "loop": False,
        "speed": 2,
    }


def values_of(schema: dict) -> tuple[list, list]:
    """Returns values at the limits of a schema, and values beyond them."""
    (schema, *_) = schema.get("anyOf", [schema])
    step = schema.get("multipleOf", 1)
    good = [schema[name] for name in ("minimum", "maximum") if name in schema]
    bad = [schema[name] + sign * step for name, sign in (("minimum", -1), ("maximum", 1)) if name in schema]
    if "exclusiveMinimum" in schema:
        bad.append(schema["exclusiveMinimum"])
    if "maxItems" in schema:
        good += [["a"] * schema[name] for name in ("minItems", "maxItems")]
        bad += [["a"] * (schema["minItems"] - 1), ["a"] * (schema["maxItems"] + 1)]
    return good, bad


@pytest.mark.parametrize("name", sorted(LIMITS))
def test_limits_are_those_of_the_description(walk, name):  # noqa: F811
    model = MotionBody if name in MotionBody.model_fields else FileParameters
    good, bad = values_of(model.model_json_schema()["properties"][name])
    assert bad
    if model is FileParameters:
        for value in good:
            Changes(**read_parameters(model, [(name, str(value))]))
        for value in bad:
            with pytest.raises(UserError, match=name):
                read_parameters(model, [(name, str(value))])
        return
    body = GOOD | ({"span": [1, 2]} if name == "candidates" else {})  # it is only for a span
    for value in good:
        request_of(body | {name: value}, walk)
    for value in bad:
        with pytest.raises(UserError, match=name):
            request_of(body | {name: value}, walk)
