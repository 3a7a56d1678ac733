"""The description of the HTTP interface says what the server does."""

import json

import pytest

from t2m_jax.serving.answers import EVENTS
from t2m_jax.serving.app import make_app
from t2m_jax.serving.jobs import FINAL_EVENTS, Jobs
from t2m_jax.serving.openapi import openapi
from t2m_jax.serving.schema import CharacterParameters, FileParameters, MotionBody, SceneParameters
from tests.export.conftest import walk  # noqa: F401 - a fixture
from tests.serving.test_files import data_of

DESCRIPTION = openapi()
SCHEMAS = DESCRIPTION["components"]["schemas"]


def test_it_is_valid():
    validator = pytest.importorskip("openapi_spec_validator", reason="openapi-spec-validator is not installed")
    validator.validate(json.loads(json.dumps(DESCRIPTION)))


def test_every_route_and_method_is_named():
    app = make_app(Jobs("none"))
    routes = {(route.path, method.lower()) for route in app.routes for method in route.methods - {"HEAD"}}
    routes = {("/assets/{name}" if path.startswith("/assets/") else path, method) for path, method in routes}
    assert routes == {
        (path, method) for path, methods in DESCRIPTION["paths"].items() for method in methods if method != "parameters"
    }


def test_every_field_is_named():
    assert SCHEMAS["MotionBody"] | {"title": ""} == MotionBody.model_json_schema() | {"title": ""}
    for path, model in (("/files", FileParameters), ("/scene", SceneParameters), ("/character", CharacterParameters)):
        parameters = {one["name"]: one for one in DESCRIPTION["paths"][path]["post"]["parameters"]}
        assert list(parameters) == list(model.model_fields)
        assert parameters["loop"]["schema"]["type"] == "boolean"
        assert parameters["fps"]["schema"]["type"] == "number"  # null cannot be in an address


def test_events_are_described():
    assert {data.__name__ for data in EVENTS.values()} <= set(SCHEMAS) and set(FINAL_EVENTS) <= set(EVENTS)


def check(schema: dict, data: object) -> None:
    """Compares the names of nested objects with their schema."""
    if "anyOf" in schema:
        schema = {} if data is None else schema["anyOf"][0]
    if "$ref" in schema:
        schema = SCHEMAS[schema["$ref"].rpartition("/")[2]]
    if isinstance(data, dict) and "properties" in schema:
        assert set(schema["required"]) <= set(data) <= set(schema["properties"])
        for name, value in data.items():
            check(schema["properties"][name], value)
    elif isinstance(data, list) and data:
        check(schema["items"], data[0])


@pytest.mark.slow
def test_answers_are_as_described(server, walk):  # noqa: F811
    assert server.ask("GET", "/openapi.json").json == json.loads(json.dumps(DESCRIPTION))
    check({"$ref": "/ModelData"}, server.ask("GET", "/model").json)
    check({"$ref": "/HealthData"}, server.ask("GET", "/health").json)
    check({"$ref": "/OpenedFile"}, server.ask("POST", "/scene", data_of(walk)).json)
    check({"$ref": "/ErrorData"}, server.ask("POST", "/scene", b"").json)
    for name, data in server.ask("POST", "/motions", {"captions": ["a person swims"]}).events:
        check({"$ref": f"/{EVENTS[name].__name__}"}, data)
