"""Typed configs: frozen dataclasses that are read strictly from YAML and changed from the command line.

A config file contains what differs from the defaults of its dataclass. Reading is strict: an unknown key, a missing
field or a value of another type is an error of one line that names the file, the line and the field.

Many modules import this one. Therefore tyro, and `t2m_jax.files` with numpy, are imported where they are used.
"""

import contextlib
import dataclasses
import difflib
import io
import itertools
import math
import reprlib
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union

from t2m_jax.errors import UserError
from t2m_jax.yaml_file import load_yaml, yaml_text

T = TypeVar("T")


class Tagged(typing.NamedTuple):
    """Marks a field whose class depends on the `kind` in its section: `tokenizer: Annotated[Any, Tagged(find)]`."""

    find: Callable[[str], type]
    """Returns the config class of a kind. Raises `UserError` if the kind is unknown."""
    default: str | None = None
    """Kind of a section that does not name one."""


class _FieldError(Exception):
    """A problem in one field of a config.

    The message names the field. `keys` lead to it, so that a reader of files can add the line.
    """

    def __init__(self, keys: tuple[str, ...], message: str):
        super().__init__(message)
        self.keys = keys


def load_config(path: str | Path, schema: type[T]) -> T:
    """Returns the config in a YAML file; fields that the file leaves out keep their defaults.

    Raises:
        UserError: The file is missing, is not YAML, or does not fit the schema.
    """
    file = load_yaml(path)
    return _config(schema, file.data, source=f"{path}", lines=file.lines)


def load_versioned(path: str | Path, schema: type[T], *, version: int) -> T:
    """Returns the config of a file whose field `format_version` must be `version`; without this field it is 1.

    Raises:
        UserError: The file has another version, or does not fit the schema.
    """
    file = load_yaml(path)
    found = file.data.get("format_version", 1)
    if type(found) is not int or found != version:
        older = "is of an older t2m_jax; use it with t2m_jax 0.1, or make it again"
        unknown = f"is unknown to this t2m_jax (known: {version}); update t2m_jax"
        advice = older if type(found) is int and found < version else unknown
        raise UserError(f"{path}: format_version {reprlib.repr(found)} {advice}")
    return _config(schema, file.data, source=f"{path}", lines=file.lines)


def config_from_dict(schema: type[T], data: Mapping[str, Any], *, source: str = "config") -> T:
    """Returns the config in nested dictionaries and lists; error messages begin with `source`."""
    return _config(schema, data, source=source, lines={})


def _config(schema: type[T], data: Any, *, source: str, lines: Mapping[tuple[str, ...], int]) -> T:
    try:
        return _section(schema, data, ())
    except _FieldError as error:
        # A missing field has no line; its section does.
        line = lines.get(error.keys, lines.get(error.keys[:-1]))
        raise UserError(f"{source}:{line}: {error}" if line else f"{source}: {error}") from error


def config_to_dict(config: Any) -> dict[str, Any]:
    """Returns a config as nested dictionaries and lists of plain values, for `config_from_dict`."""
    kind = tag_of(type(config))
    tag = {} if kind is None else {"kind": kind}
    return tag | {field.name: _plain(getattr(config, field.name)) for field in dataclasses.fields(config)}


def flat_fields(config: Any) -> dict[str, Any]:
    """Returns the plain values of a config by dotted name, such as `train.lr`."""
    flat: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            flat |= {f"{field.name}.{name}": below for name, below in flat_fields(value).items()}
        else:
            flat[field.name] = _plain(value)
    return flat


def tag_of(schema: type) -> str | None:
    """Returns the kind that a config class declares as `kind: ClassVar[str]`, or None."""
    is_field = any(field.name == "kind" for field in dataclasses.fields(schema))
    return None if is_field else getattr(schema, "kind", None)


def save_config(path: str | Path, config: Any) -> None:
    """Writes every field of a config as YAML, defaults included.

    Raises:
        UserError: The file cannot be written, or `load_config` could not read the values back.
    """
    from t2m_jax.files.writing import save_text

    save_text(path, config_text(config, source=f"{path}"))


def config_text(config: Any, *, source: str = "config") -> str:
    """Returns every field of a config as YAML, defaults included.

    Raises:
        UserError: `load_config` could not read the values back.
    """
    data = config_to_dict(config)
    config_from_dict(type(config), data, source=source)
    return yaml_text(data)


def override_config(config: T, args: Sequence[str], *, prog: str) -> T:
    """Returns the config with fields changed by command-line options such as `--train.lr 1e-4`.

    `--help` lists all fields with their docstrings and current values, then exits with code 0.

    Raises:
        UserError: An option is unknown, or a value does not fit its field.
    """
    import tyro

    messages = io.StringIO()
    try:
        with contextlib.redirect_stderr(messages):
            changed, unknown = tyro.cli(
                type(config), default=config, args=args, prog=prog, use_underscores=True, return_unknown_args=True
            )
    except SystemExit as exit_:
        if not exit_.code:
            raise
        # tyro draws a box, in ASCII if need be: a title, the message, a rule, then help texts.
        drawn = [line.strip("│ ") for line in messages.getvalue().splitlines()[1:]]
        start = 1 if drawn and _is_rule(drawn[0]) else 0
        message = itertools.takewhile(lambda line: not _is_rule(line), drawn[start:])
        reason = " ".join(" ".join(message).split()) or "cannot read the options"
        raise UserError(f"{prog}: {reason}") from None
    if unknown:
        names = [f"--{name}" for name in _field_names(type(config))]
        raise UserError(f"{prog}: unknown option '{unknown[0]}'{_nearest(unknown[0].split('=')[0], names)}")
    return config_from_dict(type(config), config_to_dict(changed), source=prog)


def _is_rule(line: str) -> bool:
    return bool(line) and not line.strip("─-╰╯")


def _section(schema: type[T] | Tagged, data: Any, keys: tuple[str, ...]) -> T:
    """Returns an instance of a dataclass from a mapping of its fields; `keys` lead to it from the root.

    Raises:
        _FieldError: Something does not fit.
    """
    if not isinstance(data, Mapping):
        raise _FieldError(keys, f"{_dotted(keys)}: expected a section of fields, got {reprlib.repr(data)}")
    data = dict(data)
    if isinstance(schema, Tagged):
        schema = _tagged_class(schema, data, keys)
    kind = tag_of(schema)
    if kind is not None and data.pop("kind", kind) != kind:
        raise _FieldError((*keys, "kind"), f"{_dotted((*keys, 'kind'))}: expected {kind!r}, the kind of this section")
    annotations = typing.get_type_hints(schema, include_extras=True)
    fields = {field.name: field for field in dataclasses.fields(schema)}  # type: ignore[arg-type]
    for key in data:
        if key not in fields:
            here = (*keys, str(key))
            names = [_dotted((*keys, name)) for name in dict.fromkeys((*fields, *_field_names(schema)))]
            raise _FieldError(here, f"unknown key '{_dotted(here)}'{_nearest(_dotted(here), names)}")
    values = {name: _value(annotations[name], value, (*keys, name)) for name, value in data.items()}
    for name, field in fields.items():
        if name not in data and field.default is field.default_factory is dataclasses.MISSING:
            raise _FieldError(keys, f"missing field '{_dotted((*keys, name))}'; it has no default")
    try:
        return schema(**values)
    except ValueError as error:  # from `__post_init__`
        raise _FieldError(keys, f"{_dotted(keys)}: {error}" if keys else str(error)) from error


def _tagged_class(tagged: Tagged, data: Mapping[str, Any], keys: tuple[str, ...]) -> type:
    """Returns the config class that the `kind` of a section names."""
    kind = data.get("kind", tagged.default)
    here = (*keys, "kind")
    try:
        if not isinstance(kind, str):
            raise UserError(f"expected text that names the kind of this section, got {reprlib.repr(kind)}")
        return tagged.find(kind)
    except UserError as error:
        raise _FieldError(here, f"{_dotted(here)}: {error}") from error


def _value(annotation: Any, value: Any, keys: tuple[str, ...]) -> Any:
    """Returns a value of an annotated type; whole numbers become floats, lists tuples, and texts paths."""
    origin = typing.get_origin(annotation)
    arguments = typing.get_args(annotation)
    if origin is Annotated:
        is_tagged = isinstance(arguments[1], Tagged)
        return _section(arguments[1], value, keys) if is_tagged else _value(arguments[0], value, keys)
    if dataclasses.is_dataclass(annotation):
        return _section(typing.cast(type, annotation), value, keys)
    if origin in (Union, types.UnionType):
        if value is None and types.NoneType in arguments:
            return None
        members = [member for member in arguments if member is not types.NoneType]
        if len(members) == 1:  # the errors of the only member are more precise than ours
            return _value(members[0], value, keys)
        # The first that fits: 1 is a whole number before it is a float.
        for member in members:
            with contextlib.suppress(_FieldError):
                return _value(member, value, keys)
    elif origin is tuple and isinstance(value, list | tuple):
        if arguments[-1] is Ellipsis:
            arguments = arguments[:1] * len(value)
        if len(arguments) == len(value):
            return tuple(_value(argument, item, keys) for argument, item in zip(arguments, value, strict=True))
    elif _fits(annotation, value):
        return annotation(value) if annotation in (float, Path) else value
    shown = "a section" if isinstance(value, Mapping) else reprlib.repr(value)
    raise _FieldError(keys, f"{_dotted(keys)}: expected {_described(annotation)}, got {shown}")


def _fits(annotation: Any, value: Any) -> bool:
    """Returns whether a value fits a scalar type: True is not a number, and NaN fits nothing."""
    if typing.get_origin(annotation) is Literal:
        return any(value == choice and type(value) is type(choice) for choice in typing.get_args(annotation))
    if annotation is float:  # larger whole numbers have no float
        return (type(value) is float and not math.isnan(value)) or (type(value) is int and abs(value) < 2**1000)
    if annotation in (str, Path):  # `${` is refused in files, too: it would look like an interpolation
        return isinstance(value, str | annotation) and "${" not in str(value)
    return annotation in (bool, int) and type(value) is annotation


def _plain(value: Any) -> Any:
    """Returns a field's value in the types that YAML has."""
    if dataclasses.is_dataclass(value):
        return config_to_dict(value)
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return value.as_posix() if isinstance(value, Path) else value


def _described(annotation: Any) -> str:
    """Returns what a user would call the values of a type."""
    origin = typing.get_origin(annotation)
    arguments = typing.get_args(annotation)
    if origin is Literal:
        return f"one of {', '.join(repr(choice) for choice in arguments)}"
    if origin in (Union, types.UnionType):
        return " or ".join(_described(member) for member in arguments)
    if origin is tuple:
        return f"a list [{', '.join('…' if item is Ellipsis else _described(item) for item in arguments)}]"
    names = {bool: "true or false", int: "a whole number", float: "a number", str: "text (in quotes if need be)"}
    return (names | {Path: "a path", types.NoneType: "null"}).get(annotation, "a section of fields")


def _field_names(schema: type) -> list[str]:
    """Returns the dotted names of all fields of a config class, sections below it included."""
    annotations = typing.get_type_hints(schema)
    names = []
    for field in dataclasses.fields(schema):
        annotation = annotations[field.name]
        sections = [part for part in (annotation, *typing.get_args(annotation)) if dataclasses.is_dataclass(part)]
        below = [f"{field.name}.{name}" for part in sections for name in _field_names(typing.cast(type, part))]
        names += below or [field.name]
    return names


def _nearest(name: str, known: Sequence[str]) -> str:
    """Returns the end of an error message: the known name nearest to an unknown one, or all known names.

    Only the part after the last dot is compared, because a field in the wrong section is a common mistake.
    """
    last_names = [choice.lstrip("-").rpartition(".")[2] for choice in known]
    found = difflib.get_close_matches(name.lstrip("-").rpartition(".")[2], last_names, n=1)
    if not found:
        return f"; known: {', '.join(known)}"
    choices = [choice for choice, last_name in zip(known, last_names, strict=True) if last_name == found[0]]
    return f"; did you mean '{(difflib.get_close_matches(name, choices, n=1) or choices)[0]}'?"


def _dotted(keys: tuple[str, ...]) -> str:
    """Returns the keys as one short line: unknown keys may be long and have line breaks."""
    return " ".join(".".join(keys).split())[:100] or "the config"
