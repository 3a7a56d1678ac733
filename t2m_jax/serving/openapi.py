"""The description of the HTTP interface in OpenAPI 3.1, made from the models of `schema`."""

from importlib.metadata import version
from typing import Any

from pydantic import BaseModel, TypeAdapter

from t2m_jax.serving import schema

Schema = dict[str, Any]

ERRORS = {
    400: "A field or a parameter cannot be used. `error` names it.",
    401: "The token is missing or wrong.",
    403: "A page of another server sent the request.",
    408: "The body came too slowly.",
    413: f"The body has more than {schema.MAX_BODY:,} bytes.",
    415: "The body is not `application/json`.",
    422: "The motion cannot be made, for example because `span` is outside of `start`.",
    429: "The queue is full. The header `Retry-After` and `retry_after` say after how many seconds to try again.",
    503: "The server cannot answer now, for example because it restarts a process. Try again.",
}
TEMPLATE = "#/components/schemas/{model}"
TEXT: Schema = {"type": "string"}
SHARED = (400, 401, 403, 408, 413, 429, 503)
"""Errors of all requests that make something."""


def openapi() -> Schema:
    """Returns the description as plain data."""
    types: list[Any] = [schema.MotionBody, schema.FileBody, schema.ModelData, schema.OpenedFile]
    types += [schema.HealthData, schema.ErrorData, *schema.EVENTS.values()]
    adapters: list[Any] = [(data.__name__, "validation", TypeAdapter(data)) for data in types]
    # All at once, so that parts that several have, such as scenes, are described once.
    _, schemas = TypeAdapter.json_schemas(adapters, ref_template=TEMPLATE)
    token = {"type": "http", "scheme": "bearer"}
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "t2m serve",
            "summary": "Motions from sentences",
            "version": version("t2m-jax"),
            "license": {"name": "Apache 2.0", "identifier": "Apache-2.0"},
        },
        "paths": {path: {"get": answer} for path, answer in _answers().items()}
        | {path: {"post": answer} for path, answer in _makers().items()},
        "security": [{}, {"token": []}],
        "components": {"schemas": schemas["$defs"], "securitySchemes": {"token": token}},
    }


def _answers() -> Schema:
    """Returns what the page consists of, and what the server says of itself."""
    page = _operation("The page", {"text/html": TEXT})
    asset = _operation("A part of the page", {"text/plain": TEXT})
    asset["parameters"] = [{"name": "name", "in": "path", "required": True, "schema": TEXT}]
    asset["responses"]["404"] = _response("There is no such part.", _json(schema.ErrorData))
    health = _operation("Whether the server can generate", _json(schema.HealthData))
    health["responses"]["503"] = _response("A process is being restarted.", _json(schema.HealthData))
    description = _operation("This description", {"application/json": {"type": "object"}})
    answers = {"/": page, "/assets/{name}": asset, "/health": health, "/openapi.json": description}
    return {path: answer | {"security": []} for path, answer in answers.items()} | {
        "/metrics": _operation("Counters for Prometheus", {"text/plain": TEXT}, errors=(401,)),
        "/model": _operation("The model, and all choices and limits", _json(schema.ModelData), errors=(401,)),
    }


def _makers() -> Schema:
    """Returns what makes motions and files."""
    events = schema.EVENTS
    data = {"application/octet-stream": {"type": "string", "contentMediaType": "application/octet-stream"}}
    stream = {"text/event-stream": TEXT} | _json(events["done"])
    motions = _operation("Make motions", stream, body=_json(schema.MotionBody), errors=(*SHARED, 415, 422))
    kinds = "\n".join(f"- `{name}`: {data.__doc__} See the schema `{data.__name__}`." for name, data in events.items())
    motions["description"] = (
        f"The answer is server-sent events:\n\n{kinds}\n\nWith `Accept: application/json`, it is the data of the "
        "event `done` instead. Closing the connection cancels the request."
    )
    files = _operation("Convert .npz files of motions", data, body=data | _json(schema.FileBody), errors=SHARED)
    files["parameters"] = _parameters(schema.FileParameters)
    scene = _operation("Read a motion file, and change it", _json(schema.OpenedFile), body=data, errors=SHARED)
    scene["parameters"] = _parameters(schema.SceneParameters)
    return {"/motions": motions, "/files": files, "/scene": scene}


def _operation(summary: str, answer: Schema, *, body: Schema | None = None, errors: tuple[int, ...] = ()) -> Schema:
    """Returns the description of a method of a path; contents are schemas by media type."""
    responses = {f"{status}": _response(ERRORS[status], _json(schema.ErrorData)) for status in errors}
    found: Schema = {"summary": summary, "responses": {"200": _response("The answer.", answer)} | responses}
    return found if body is None else found | {"requestBody": {"required": True, "content": _content(body)}}


def _parameters(model: type[BaseModel]) -> list[Schema]:
    """Returns a parameter for each field of a model."""
    found = []
    for name, field in model.model_json_schema()["properties"].items():
        text = field.pop("description")
        # In an address, there is no null: the parameter is left out.
        plain = field["anyOf"][0] if "anyOf" in field else field
        found.append({"name": name, "in": "query", "description": text, "schema": plain})
    return found


def _content(schemas: Schema) -> Schema:
    return {media_type: {"schema": found} for media_type, found in schemas.items()}


def _json(data: Any) -> Schema:
    return {"application/json": {"$ref": TEMPLATE.format(model=data.__name__)}}


def _response(text: str, content: Schema) -> Schema:
    return {"description": text, "content": _content(content)}
