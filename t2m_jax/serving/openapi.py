"""The description of the HTTP interface in OpenAPI 3.1: `openapi.yaml` with the models of `schema`."""

from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import BaseModel, TypeAdapter

from t2m_jax.serving import answers, schema
from t2m_jax.yaml_file import load_yaml

POST_ERRORS = ("400", "401", "403", "408", "413", "429", "503")
"""Answers to any request with a body that cannot be used now."""


def openapi() -> dict[str, Any]:
    """Returns the description as plain data."""
    found = load_yaml(Path(__file__).with_name("openapi.yaml")).data
    found["info"]["version"] = version("t2m-jax")
    types: list[Any] = [schema.MotionBody, schema.FileBody, schema.CharacterBody, answers.ModelData, answers.OpenedFile]
    types += [answers.HealthData, answers.ErrorData, *answers.EVENTS.values()]
    adapters: list[Any] = [(data.__name__, "validation", TypeAdapter(data)) for data in types]
    # All at once, so that parts that several have, such as scenes, are described once.
    _, schemas = TypeAdapter.json_schemas(adapters, ref_template="#/components/schemas/{model}")
    found["components"]["schemas"] = schemas["$defs"]
    models: dict[str, type[BaseModel]] = {
        "/motions": schema.KeepParameters,
        "/files": schema.FileParameters,
        "/scene": schema.SceneParameters,
        "/character": schema.CharacterParameters,
    }
    for path, model in models.items():
        found["paths"][path]["post"]["parameters"] = _parameters(model)
    for response in found["components"]["responses"].values():
        response["content"] = {"application/json": {"schema": {"$ref": "#/components/schemas/ErrorData"}}}
    for path in models:
        found["paths"][path]["post"]["responses"] |= {
            code: {"$ref": f"#/components/responses/{code}"} for code in POST_ERRORS
        }
    events = [f"- `{name}`: {kind.__doc__} See the schema `{kind.__name__}`." for name, kind in answers.EVENTS.items()]
    texts = {"events": "\n".join(events), "bytes": f"{schema.MAX_BODY:,}"}
    texts["character"] = f"{schema.MAX_CHARACTER_BODY:,}"
    for part in (found["paths"]["/motions"]["post"], found["components"]["responses"]["413"]):
        part["description"] = part["description"].format(**texts)
    return found


def _parameters(model: type[BaseModel]) -> list[dict[str, Any]]:
    """Returns a parameter for each field of a model."""
    found = []
    for name, field in model.model_json_schema()["properties"].items():
        text = field.pop("description")
        # In an address, there is no null: the parameter is left out.
        plain = field["anyOf"][0] if "anyOf" in field else field
        found.append({"name": name, "in": "query", "description": text, "schema": plain})
    return found
