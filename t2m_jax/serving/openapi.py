"""The description of the HTTP interface in OpenAPI 3.1, made from the models of `schema`."""

from importlib.metadata import version
from typing import Any

from pydantic import BaseModel, TypeAdapter

from t2m_jax.serving.schema import (
    EVENTS,
    MAX_BODY,
    ErrorData,
    FileBody,
    FileParameters,
    HealthData,
    ModelData,
    MotionBody,
    OpenedFile,
    SceneParameters,
)

Schema = dict[str, Any]

ERRORS = {
    400: "A field or a parameter cannot be used. `error` names it.",
    401: "The token is missing or wrong.",
    403: "A page of another server sent the request.",
    408: "The body came too slowly.",
    413: f"The body has more than {MAX_BODY:,} bytes.",
    415: "The body is not `application/json`.",
    422: "The motion cannot be made, for example because `span` is outside of `start`.",
    429: "The queue is full. The header `Retry-After` and `retry_after` say after how many seconds to try again.",
    503: "The server cannot answer now, for example because it restarts a process. Try again.",
}
TEMPLATE = "#/components/schemas/{model}"
FILE: Schema = {"type": "string", "contentMediaType": "application/octet-stream"}
TEXT: Schema = {"type": "string"}


def openapi() -> Schema:
    """Returns the description as plain data."""
    types: list[Any] = [MotionBody, FileBody, ModelData, OpenedFile, HealthData, ErrorData, *EVENTS.values()]
    adapters: list[Any] = [(data.__name__, "validation", TypeAdapter(data)) for data in types]
    # All at once, so that parts that several have, such as scenes, are described once.
    _, schemas = TypeAdapter.json_schemas(adapters, ref_template=TEMPLATE)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "t2m serve",
            "summary": "Motions from sentences",
            "version": version("t2m-jax"),
            "license": {"name": "Apache 2.0", "identifier": "Apache-2.0"},
        },
        "paths": _open_paths() | _paths(),
        "security": [{}, {"token": []}],
        "components": {
            "schemas": schemas["$defs"],
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
    }


def _open_paths() -> Schema:
    """Returns what the page consists of, and what the server says of itself."""
    part = {"name": "name", "in": "path", "required": True, "schema": TEXT}
    page = _operation("The page", {"text/html": TEXT}, is_open=True)
    asset = _operation("A part of the page", {"text/plain": TEXT}, parameters=[part], is_open=True)
    asset["responses"]["404"] = _error("There is no such part.")
    health = _operation("Whether the server can generate", _json(HealthData), is_open=True)
    health["responses"]["503"] = _response("The process that generates is being restarted.", _json(HealthData))
    answers = {
        "/": page,
        "/assets/{name}": asset,
        "/health": health,
        "/openapi.json": _operation("This description", {"application/json": {"type": "object"}}, is_open=True),
        "/metrics": _operation("Counters for Prometheus", {"text/plain": TEXT}, errors=(401,)),
        "/model": _operation("The model, and all choices and limits", _json(ModelData), errors=(401,)),
    }
    return {path: {"get": operation} for path, operation in answers.items()}


def _paths() -> Schema:
    """Returns what makes motions and files."""
    events = "\n".join(f"- `{name}`: {data.__doc__} See the schema `{data.__name__}`." for name, data in EVENTS.items())
    shared = (400, 401, 403, 408, 413, 429, 503)
    motions = _operation(
        "Make motions",
        {"text/event-stream": TEXT} | _json(EVENTS["done"]),
        body=_json(MotionBody),
        errors=(*shared, 415, 422),
    )
    motions["description"] = (
        f"The answer is server-sent events:\n\n{events}\n\nWith `Accept: application/json`, it is the data of the "
        "event `done` instead. Closing the connection cancels the request."
    )
    data = {"application/octet-stream": FILE}
    files = _operation(
        "Convert .npz files of motions",
        data,
        body=data | _json(FileBody),
        parameters=_parameters(FileParameters),
        errors=shared,
    )
    scene = _operation(
        "Read a motion file, and change it",
        _json(OpenedFile),
        body=data,
        parameters=_parameters(SceneParameters),
        errors=shared,
    )
    return {"/motions": {"post": motions}, "/files": {"post": files}, "/scene": {"post": scene}}


def _operation(
    summary: str,
    answer: Schema,
    *,
    body: Schema | None = None,
    parameters: list[Schema] | None = None,
    errors: tuple[int, ...] = (),
    is_open: bool = False,
) -> Schema:
    """Returns the description of a method of a path; contents are schemas by media type."""
    responses = {"200": _response("The answer.", answer)} | {str(status): _error(ERRORS[status]) for status in errors}
    found: Schema = {"summary": summary, "responses": responses}
    if body is not None:
        found["requestBody"] = {"required": True} | _content(body)
    if parameters is not None:
        found["parameters"] = parameters
    return found | ({"security": []} if is_open else {})


def _parameters(model: type[BaseModel]) -> list[Schema]:
    """Returns a parameter for each field of a model."""
    found = []
    for name, schema in model.model_json_schema()["properties"].items():
        text = schema.pop("description")
        # In an address, there is no null: the parameter is left out.
        plain = schema["anyOf"][0] if "anyOf" in schema else schema
        found.append({"name": name, "in": "query", "description": text, "schema": plain})
    return found


def _content(schemas: Schema) -> Schema:
    return {"content": {media_type: {"schema": schema} for media_type, schema in schemas.items()}}


def _json(data: Any) -> Schema:
    return {"application/json": {"$ref": TEMPLATE.format(model=data.__name__)}}


def _response(text: str, content: Schema) -> Schema:
    return {"description": text} | _content(content)


def _error(text: str) -> Schema:
    return _response(text, _json(ErrorData))
