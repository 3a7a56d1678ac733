"""Fields of the records that say what users may ask for. The command line and the HTTP schema are made from them."""

import ast
import dataclasses
import inspect
import textwrap
import typing
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

T = TypeVar("T")


class RecordField(NamedTuple):
    """From a record to one option of the command line, or one field of the HTTP interface."""

    name: str
    annotation: Any
    default: Any
    """`dataclasses.MISSING` if the field must be given."""
    text: str
    """The docstring under the field, in one line."""


def fields_of(record: type) -> Iterator[RecordField]:
    """Yields the fields of a dataclass. In place of a field that is a record itself, its fields follow."""
    annotations = typing.get_type_hints(record)
    texts = _docstrings(record)
    for field in dataclasses.fields(record):
        annotation = annotations[field.name]
        if dataclasses.is_dataclass(annotation):
            yield from fields_of(typing.cast(type, annotation))
        else:
            yield RecordField(field.name, annotation, field.default, texts.get(field.name, ""))


def record_from(record: type[T], values: Mapping[str, Any]) -> T:
    """Returns a record with values by the names of `fields_of`; a field without a value has its default.

    Raises:
        UserError: A value cannot be used.
    """
    annotations = typing.get_type_hints(record)
    given: dict[str, Any] = {}
    for field in dataclasses.fields(record):  # type: ignore[arg-type]
        annotation = annotations[field.name]
        if dataclasses.is_dataclass(annotation):
            given[field.name] = record_from(typing.cast(type, annotation), values)
        elif field.name in values:
            given[field.name] = values[field.name]
    return record(**given)


def _docstrings(record: type) -> dict[str, str]:
    """Returns the docstrings under fields. Python keeps them only in the source."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(record))).body
    assert isinstance(definition, ast.ClassDef)
    found = {}
    for field, text in zip(definition.body, definition.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(text, ast.Expr):
            found[field.target.id] = " ".join(str(ast.literal_eval(text.value)).split())
    return found
