"""The description of the HTTP interface says what the server does."""

import dataclasses
import json

import pytest

from t2m_jax.errors import UserError
from t2m_jax.serving.app import make_app
from t2m_jax.serving.files import FileOptions, options_from_query
from t2m_jax.serving.jobs import FINAL_EVENTS, Jobs
from t2m_jax.serving.openapi import EVENTS, LIMITS, fields_of, openapi
from t2m_jax.serving.requests import MotionRequest, request_from_json

DESCRIPTION = openapi()
SCHEMAS = DESCRIPTION["components"]["schemas"]


def test_it_is_valid():
    validator = pytest.importorskip("openapi_spec_validator", reason="openapi-spec-validator is not installed")
    validator.validate(json.loads(json.dumps(DESCRIPTION)))


def test_every_route_and_method_is_named():
    app = make_app(Jobs("none"))
    routes = {(route.path, method.lower()) for route in app.routes for method in route.methods - {"HEAD"}}
    routes = {("/assets/{name}" if path.startswith("/assets/") else path, method) for path, method in routes}
    assert routes == {(path, method) for path, methods in DESCRIPTION["paths"].items() for method in methods}


def test_every_field_is_named_with_its_default():
    request = SCHEMAS["MotionRequest"]
    for field in dataclasses.fields(MotionRequest):
        found = request["properties"][field.name]
        assert found["description"].endswith(".") and (field.name in request["required"]) == ("default" not in found)
    parameters = {one["name"]: one for one in DESCRIPTION["paths"]["/files"]["post"]["parameters"]}
    assert list(parameters) == [field.name for field in dataclasses.fields(FileOptions)]
    assert parameters["loop"]["schema"] == {"enum": [0, 1], "default": 0}
    assert parameters["fps"]["schema"] == {"enum": [20, 24, 30, 60]}
    assert request["properties"]["seed"]["type"] == ["integer", "null"]


def values_of(schema: dict) -> tuple[list, list]:
    """Returns values at the limits of a schema, and values beyond them."""
    good, bad = [], []
    if "enum" in schema:
        return schema["enum"], ["other"]
    for name, beyond in (("minimum", -1), ("maximum", 1)):
        if name in schema:
            good.append(schema[name])
            bad.append(schema[name] + beyond)
    if "exclusiveMinimum" in schema:
        bad.append(schema["exclusiveMinimum"])
    if "maxItems" in schema:
        item = "a" if schema["items"]["type"] == "string" else 1.5
        good += [[item] * schema[name] for name in ("minItems", "maxItems")]
        bad += [[item] * (schema["minItems"] - 1), [item] * (schema["maxItems"] + 1)]
    return good, bad


@pytest.mark.parametrize("name", [*LIMITS, "span", "variety", "motion_format"])
def test_limits_are_those_of_the_server(name):
    if name in ("begin", "motion"):
        return
    good, bad = values_of(fields_of(MotionRequest)[name])
    assert bad
    given = {"captions": ["a person walks"]}
    if name == "span":
        given |= {"edit": "redo", "motion": "AAAA"}
    for value in good:
        request_from_json(given | {name: value})
    for value in bad:
        with pytest.raises(UserError, match=name):
            request_from_json(given | {name: value})


def test_parameters_accept_what_is_described():
    for parameter in DESCRIPTION["paths"]["/files"]["post"]["parameters"]:
        for value in parameter["schema"].get("enum", [1]):
            options_from_query({parameter["name"]: str(value)})


def test_events_are_described():
    assert {f"{name.title()}Event" for name in EVENTS} <= set(SCHEMAS) and set(FINAL_EVENTS) <= set(EVENTS)


def check(schema: dict, data: object) -> None:
    """Compares the names of nested objects with their schema."""
    if "oneOf" in schema:
        schema = {} if data is None else schema["oneOf"][0]
    if "$ref" in schema:
        schema = SCHEMAS[schema["$ref"].rpartition("/")[2]]
    if isinstance(data, dict) and "properties" in schema:
        assert set(schema["required"]) <= set(data) <= set(schema["properties"])
        for name, value in data.items():
            check(schema["properties"][name], value)
    elif isinstance(data, list) and data:
        check(schema["items"], data[0])


def test_answers_are_as_described(server):
    assert server.ask("GET", "/openapi.json").json == json.loads(json.dumps(DESCRIPTION))
    check({"$ref": "/Model"}, server.ask("GET", "/model").json)
    check({"$ref": "/Health"}, server.ask("GET", "/health").json)
    check({"$ref": "/Error"}, server.ask("POST", "/scene", b"").json)
    for name, data in server.ask("POST", "/motions", {"captions": ["a person swims"]}).events:
        check({"$ref": f"/{name.title()}Event"}, data)
