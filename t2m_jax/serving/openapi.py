"""The description of the HTTP interface in OpenAPI 3.1. Fields come from the classes that check them."""

import ast
import dataclasses
import inspect
import textwrap
import types
import typing
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any, Literal, Union

from t2m_jax.serving.files import MAX_MOTIONS, FileOptions
from t2m_jax.serving.requests import (
    INPUT_FORMATS,
    MAX_BODY,
    MAX_CAPTIONS,
    MAX_GUIDANCE_SCALE,
    MAX_SAMPLES,
    MAX_SECONDS,
    MotionRequest,
)

Schema = dict[str, Any]

LIMITS: dict[str, Schema] = {
    "captions": {"minItems": 1, "maxItems": MAX_CAPTIONS},
    "seed": {"minimum": 0, "maximum": 2**32 - 1},
    "num_samples": {"minimum": 1, "maximum": MAX_SAMPLES},
    "seconds": {"exclusiveMinimum": 0, "maximum": MAX_SECONDS},
    "guidance_scale": {"minimum": 0, "maximum": MAX_GUIDANCE_SCALE},
    "strength": {"minimum": 0, "maximum": 1},
    "motion": {"contentEncoding": "base64"},
    "begin": {"minimum": 0},
}
"""What the types of fields do not say. A test compares it with what is refused."""
TEXT: Schema = {"type": "string"}
NUMBER: Schema = {"type": "number"}
WHOLE: Schema = {"type": "integer"}
ROWS: Schema = {"type": "array", "items": {"type": "array", "items": WHOLE}}
SCALARS = {str: "string", int: "integer", float: "number", bool: "boolean", types.NoneType: "null"}
ERRORS = {
    400: "A field or a parameter cannot be used. `error` names it.",
    401: "The token is missing or wrong.",
    403: "A page of another server sent the request.",
    408: "The body came too slowly.",
    413: f"The body has more than {MAX_BODY:,} bytes.",
    415: "The body is not `application/json`.",
    422: "The motion cannot be made, for example because `span` is outside of `motion`.",
    429: "The queue is full. The header `Retry-After` and `retry_after` say after how many seconds to try again.",
    503: "The server cannot answer now, for example because it restarts a process. Try again.",
}
EVENTS = {
    "queued": "The request waits. It is sent again when its position changes.",
    "started": "The model works on the request. If its process has died, the event comes again, and codes start anew.",
    "codes": "Further rows of codes of a sample. `scene` has their frames, or is null while others wait.",
    "warning": "A part of a sentence that the model does not know.",
    "done": "The last event: all motions.",
    "failed": "The last event if there is no motion.",
}


def openapi() -> Schema:
    """Returns the description as plain data."""
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "t2m serve",
            "summary": "Motions from sentences",
            "version": version("t2m-jax"),
            "license": {"name": "Apache 2.0", "identifier": "Apache-2.0"},
        },
        "paths": _page_paths() | _paths(),
        "security": [{}, {"token": []}],
        "components": {
            "schemas": _schemas(),
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
    }


def schema_of(annotation: Any) -> Schema:
    """Returns the JSON schema of a type that a field of a request may have."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin is tuple and arguments[-1] is Ellipsis:
        return {"type": "array", "items": schema_of(arguments[0])}
    if origin is tuple:
        size = len(arguments)
        return {"type": "array", "items": schema_of(arguments[0]), "minItems": size, "maxItems": size}
    if origin in (Union, types.UnionType):
        (member,) = (schema_of(one) for one in arguments if one is not types.NoneType)
        if "enum" in member:
            return {"enum": [*member["enum"], None]}
        return member | {"type": [member["type"], "null"]}
    return {"type": SCALARS[annotation]}


def fields_of(schema: type) -> dict[str, Schema]:
    """Returns the JSON schema of each field of a dataclass, with its default, limits and docstring."""
    annotations, texts = typing.get_type_hints(schema), _docstrings(schema)
    found = {}
    for field in dataclasses.fields(schema):  # type: ignore[arg-type]
        found[field.name] = schema_of(annotations[field.name]) | LIMITS.get(field.name, {})
        if field.name in texts:
            found[field.name]["description"] = texts[field.name]
        if field.default is not dataclasses.MISSING:
            found[field.name]["default"] = field.default
    return found


def _docstrings(schema: type) -> dict[str, str]:
    """Returns the docstrings under the fields of a dataclass. Python keeps them only in the source."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(schema))).body
    assert isinstance(definition, ast.ClassDef)
    found = {}
    for field, text in zip(definition.body, definition.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(text, ast.Expr):
            found[field.target.id] = str(ast.literal_eval(text.value))
    return found


def _page_paths() -> Schema:
    """Returns what the page consists of, and what the server says of itself."""
    found: Schema = {
        "/": {"get": {"summary": "The page", "responses": _ok("text/html", {"type": "string"}), "security": []}},
        "/assets/{name}": {
            "get": {
                "summary": "A part of the page",
                "parameters": [{"name": "name", "in": "path", "required": True, "schema": {"type": "string"}}],
                "responses": _ok("text/plain", {"type": "string"}) | {"404": _error("There is no such part.")},
                "security": [],
            }
        },
    }
    alive = _ok("application/json", _ref("Health"))
    alive["503"] = _response("The process that generates is being restarted.", "application/json", _ref("Health"))
    document = {"summary": "This description", "responses": _ok("application/json", {"type": "object"}), "security": []}
    metrics = {"summary": "Counters for Prometheus", "responses": _ok("text/plain", {"type": "string"}) | _errors(401)}
    described = _ok("application/json", _ref("Model")) | _errors(401)
    model = {"summary": "The model, and all choices and limits", "responses": described}
    health = {"summary": "Whether the server can generate", "responses": alive, "security": []}
    answers = {"/health": health, "/metrics": metrics, "/model": model, "/openapi.json": document}
    return found | {path: {"get": operation} for path, operation in answers.items()}


def _paths() -> Schema:
    """Returns what makes motions and files."""
    streams = "\n".join(f"- `{name}`: {text} See the schema `{name.title()}Event`." for name, text in EVENTS.items())
    done = _response(f"Server-sent events:\n\n{streams}", "text/event-stream", {"type": "string"})
    done["content"]["application/json"] = {"schema": _ref("DoneEvent")}
    motions = {
        "summary": "Make motions",
        "description": "Closing the connection cancels the request. With `Accept: application/json`, the answer is the "
        "data of the event `done` instead of events.",
        "requestBody": _body("application/json", _ref("MotionRequest")),
        "responses": {"200": done} | _errors(400, 401, 403, 408, 413, 415, 422, 429, 503),
    }
    file = {"type": "string", "contentMediaType": "application/octet-stream"}
    listed = {"type": "array", "items": LIMITS["motion"] | {"type": "string"}, "minItems": 1, "maxItems": MAX_MOTIONS}
    several = {"type": "object", "properties": {"motions": listed}, "required": ["motions"]}
    files = {
        "summary": "Convert .npz files of motions",
        "parameters": _parameters(),
        "requestBody": _body("application/octet-stream", file, "application/json", several),
        "responses": _ok("application/octet-stream", file) | _errors(400, 401, 403, 408, 413, 429, 503),
    }
    chosen = {"name": "format", "in": "query", "schema": {"enum": list(INPUT_FORMATS), "default": "npz"}}
    answer = _object({"scene": _ref("Scene"), "motion": _ref("Motion")})
    scene = {
        "summary": "Read a motion file",
        "parameters": [chosen, *(one for one in _parameters() if one["name"] != "format")],
        "requestBody": _body("application/octet-stream", file),
        "responses": _ok("application/json", answer) | _errors(400, 401, 403, 408, 413, 429, 503),
    }
    return {"/motions": {"post": motions}, "/files": {"post": files}, "/scene": {"post": scene}}


def _parameters() -> list[Schema]:
    """Returns the parameters of `FileOptions`. In an address, 0 and 1 are false and true, and null is left out."""
    found = []
    for name, field in fields_of(FileOptions).items():
        schema = {key: value for key, value in field.items() if key != "description"}
        if schema.get("type") == "boolean":
            schema = {"enum": [0, 1], "default": int(schema["default"])}
        if schema["default"] is None:
            del schema["default"]
        if "enum" in schema:
            schema["enum"] = [value for value in schema["enum"] if value is not None]
        elif isinstance(schema["type"], list):
            schema["type"] = schema["type"][0]
        text = {"description": field["description"]} if "description" in field else {}
        found.append({"name": name, "in": "query", "schema": schema} | text)
    return found


def _schemas() -> Schema:
    """Returns the objects of requests and answers."""
    request = _object(fields_of(MotionRequest), required=("captions",)) | {"additionalProperties": False}
    motion: Schema = {"caption": TEXT, "seed": {"type": ["integer", "null"]}, "fps": NUMBER, "frames": WHOLE}
    motion |= {"seconds": NUMBER, "codes": ROWS | {"type": ["array", "null"]}, "part_starts": _list(WHOLE)}
    motion |= {"part_captions": _list(TEXT), "npz": LIMITS["motion"] | TEXT}
    scene = _object({"seconds": NUMBER, "figures": _list({"type": "object"})})
    health: Schema = {"status": {"enum": ["ok", "restarting"]}, "model": TEXT, "waiting": WHOLE}
    return _event_schemas() | {
        "MotionRequest": request,
        "Motion": _object(motion),
        "Scene": scene | {"description": "What the viewer draws. Programs read `npz` instead."},
        "Model": _model_schema(),
        "Health": _object(health),
        "Error": _object({"error": TEXT, "retry_after": WHOLE}, required=("error",)),
    }


def _model_schema() -> Schema:
    """Returns what `GET /model` answers with."""
    fields: Schema = dict.fromkeys(("name", "about", "license"), TEXT)
    fields |= {"fps": NUMBER, "downsample": WHOLE, "longest_seconds": NUMBER, "guided": {"type": "boolean"}}
    fields |= {"guidance_scale": {"type": ["number", "null"]}, "fps_choices": _list(WHOLE)}
    lists = ("actions", "words", "examples", "formats", "formats_of_several", "joint_names", "input_formats")
    fields |= dict.fromkeys(lists, _list(TEXT))
    limits = dict.fromkeys(("captions", "num_samples", "seconds", "body_bytes"), NUMBER)
    return _object(fields | {"limits": _object(limits)})


def _event_schemas() -> Schema:
    """Returns the data of the events."""
    seed = WHOLE | LIMITS["seed"]
    scene: Schema = {"oneOf": [_ref("Scene"), {"type": "null"}]}
    events: dict[str, Schema] = {
        "queued": {"position": WHOLE, "seed": seed},
        "started": {"seed": seed},
        "codes": {"sample": WHOLE, "codes": ROWS, "scene": scene},
        "warning": {"message": TEXT},
        "done": {"seed": seed, "scene": _ref("Scene"), "motions": _list(_ref("Motion"))},
        "failed": {"error": TEXT, "seed": seed},
    }
    return {f"{name.title()}Event": _object(fields) | {"description": EVENTS[name]} for name, fields in events.items()}


def _object(properties: dict[str, Schema], required: Sequence[str] | None = None) -> Schema:
    return {"type": "object", "properties": properties, "required": list(properties if required is None else required)}


def _list(items: Schema) -> Schema:
    return {"type": "array", "items": items}


def _ref(name: str) -> Schema:
    return {"$ref": f"#/components/schemas/{name}"}


def _body(*types_and_schemas: Any) -> Schema:
    pairs = zip(types_and_schemas[::2], types_and_schemas[1::2], strict=True)
    return {"required": True, "content": {media_type: {"schema": schema} for media_type, schema in pairs}}


def _response(text: str, media_type: str, schema: Schema) -> Schema:
    return {"description": text, "content": {media_type: {"schema": schema}}}


def _ok(media_type: str, schema: Schema) -> Schema:
    return {"200": _response("The answer.", media_type, schema)}


def _error(text: str) -> Schema:
    return _response(text, "application/json", _ref("Error"))


def _errors(*statuses: int) -> Schema:
    return {str(status): _error(ERRORS[status]) for status in statuses}
