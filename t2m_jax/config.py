"""Typed configs: frozen dataclasses, read strictly from YAML and changed from the command line.

A config file holds what differs from the defaults of its dataclass. Reading refuses what it does not know in one line
that names the file, the line and the nearest known key. It runs nothing: no interpolation, no tags, no aliases.

OmegaConf and tyro are imported where they are used: everything imports this module, and `t2m --help` must stay quick.
"""

import contextlib
import dataclasses
import difflib
import io
import math
import os
import re
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar, Union

import yaml

from t2m_jax.errors import UserError

T = TypeVar("T")

MAX_FILE_BYTES = 100_000
"""Largest config file that is read: far above any honest one, far below what would keep the parser busy."""

MAX_DEPTH = 32
"""Deepest nesting that is read; it bounds the recursions below."""


class Tagged(typing.NamedTuple):
    """Marks a field of which the section's `kind` chooses the class: `tokenizer: Annotated[Any, Tagged(find)]`."""

    find: Callable[[str], type]
    """From a kind to its config class; raises `UserError` if there is no such kind."""


class _FieldError(Exception):
    """Something wrong at one place of a config: the keys that lead there and what to say about it."""

    def __init__(self, keys: tuple[str, ...], message: str):
        super().__init__(message)
        self.keys = keys


def load_config(path: str | Path, schema: type[T]) -> T:
    """Returns the config that a YAML file describes; fields the file leaves out keep their defaults.

    Raises:
        UserError: the file is missing, no YAML, or does not fit the schema.
    """
    path = Path(path)
    text = _read_text(path)
    try:
        lines = _check_yaml(text)
        data = _container_from_yaml(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{path}:{mark.line + 1}" if mark else f"{path}"
        raise UserError(f"{where}: cannot read this YAML: {error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise UserError(f"{path}: cannot read this YAML: {' '.join(str(error).split())}") from error
    try:
        return _dataclass_from_mapping(schema, data, ())
    except _FieldError as error:
        line = lines.get(error.keys)
        raise UserError(f"{path}:{line}: {error}" if line else f"{path}: {error}") from error


def load_versioned(path: str | Path, schemas: Mapping[int, type]) -> Any:
    """Returns the config of a file whose field `format_version` chooses the schema (1 if there is no such field).

    Raises:
        UserError: The version is unknown, or the file does not fit its schema.
    """
    path = Path(path)
    found = re.search(r"^format_version:\s*(\S+)", _read_text(path), re.MULTILINE)
    version = found[1] if found else "1"
    if not version.isdecimal() or int(version) not in schemas:
        known = ", ".join(map(str, schemas))
        raise UserError(
            f"{path}: format_version {version} is unknown to this version of t2m_jax (known: {known}); update t2m_jax"
        )
    return load_config(path, schemas[int(version)])


def config_from_dict(schema: type[T], data: Mapping[str, Any], *, source: str = "config") -> T:
    """Returns the config that nested dictionaries and lists describe; `source` is named in errors."""
    try:
        return _dataclass_from_mapping(schema, data, ())
    except _FieldError as error:
        raise UserError(f"{source}: {error}") from error


def check_sizes(config: Any, *names: str) -> None:
    """Raises `ValueError` where one of a config's fields (without names: any whole number) is below 1.

    It is meant for `__post_init__`; whatever reads the config then tells where the value stands.
    """
    for name in names or (field.name for field in dataclasses.fields(config)):
        value = getattr(config, name)
        if type(value) is int and value < 1:
            raise ValueError(f"{name}: {value} is not a whole number above 0")


def check_limits(config: Any, **limits: int) -> None:
    """Raises `ValueError` where one of a config's fields is above its limit.

    Whoever builds a model takes room and time by its config before any weight is looked at, and a config may come from
    anybody: the limits are far above any real model, and far below what would bring a machine to its knees.
    """
    for name, limit in limits.items():
        if getattr(config, name) > limit:
            raise ValueError(f"{name}: {_shown(getattr(config, name))} is more than the {limit} that any model needs")


def config_to_dict(config: Any) -> dict[str, Any]:
    """Returns a config as nested dictionaries, lists, numbers, strings and None: what `config_from_dict` takes."""
    kind = tag_of(type(config))
    tag = {} if kind is None else {"kind": kind}
    return tag | {field.name: _plain_from_value(getattr(config, field.name)) for field in dataclasses.fields(config)}


def tag_of(schema: type) -> str | None:
    """Returns the kind that a config class declares as `kind: ClassVar[str]`, None if it has none."""
    is_field = any(field.name == "kind" for field in dataclasses.fields(schema))
    return None if is_field else getattr(schema, "kind", None)


def flat_fields(config: Any) -> dict[str, Any]:
    """Returns the plain values of a config by dotted name."""
    flat: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            flat |= {f"{field.name}.{name}": below for name, below in flat_fields(value).items()}
        else:
            flat[field.name] = _plain_from_value(value)
    return flat


def save_config(path: str | Path, config: Any) -> None:
    """Writes every field of a config, defaults included, as YAML that `load_config` reads back to an equal config.

    The file appears whole or not at all, so that a run killed at this moment can still be resumed.
    """
    from omegaconf import OmegaConf

    path = Path(path)
    data = config_to_dict(config)
    config_from_dict(type(config), data, source=f"{path}")  # refuse to write what could not be read back
    partial = path.with_name(path.name + ".partial")
    partial.write_text(OmegaConf.to_yaml(OmegaConf.create(data)), encoding="utf-8")
    os.replace(partial, path)


def override_config(config: T, args: Sequence[str], *, prog: str) -> T:
    """Returns the config with fields changed as command-line options say, such as `--train.lr 1e-4`.

    `--help` among the options lists all fields with their docstrings and present values, then exits with code 0.

    Raises:
        UserError: an unknown option, or a value that does not fit its field.
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
        raise UserError(f"{prog}: {_text_in_box(messages.getvalue())}") from None
    if unknown:
        names = [f"--{name}" for name in _dotted_names(type(config))]
        raise UserError(f"{prog}: unknown option '{unknown[0]}'{_nearest(unknown[0].split('=')[0], names)}")
    return config_from_dict(type(config), config_to_dict(changed), source=prog)


def _read_text(path: Path) -> str:
    """Returns the text of a config file that exists, is UTF-8 and of a sane size."""
    if not path.exists():
        raise UserError(f"{path}: no such config file")
    if path.is_dir():
        raise UserError(f"{path}: a folder, but a YAML file is needed")
    if path.stat().st_size > MAX_FILE_BYTES:
        raise UserError(f"{path}: larger than {MAX_FILE_BYTES // 1000} kB, no config file")
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: not a text file in UTF-8 (byte {error.start})") from error


def _check_yaml(text: str) -> dict[tuple[str, ...], int]:
    """Returns the line of every key, having refused what a config may not contain before anything expands it."""
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        mark = typing.cast(yaml.Mark, event.start_mark)
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        problem = _problem_of_event(event, depth)
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    if root is not None and not isinstance(root, yaml.MappingNode):
        raise yaml.MarkedYAMLError(problem="expected 'field: value' lines", problem_mark=root.start_mark)
    return dict(_key_lines(root, ()))


def _problem_of_event(event: yaml.Event, depth: int) -> str:
    """Returns what is wrong with one piece of YAML, or nothing."""
    if depth > MAX_DEPTH:
        return f"nested deeper than {MAX_DEPTH} levels"
    if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
        return "anchors and aliases (& and *) are not supported; write the value out"
    if tag := getattr(event, "tag", None):
        return f"tags such as '{tag}' are not supported"
    if isinstance(event, yaml.ScalarEvent) and "${" in event.value:
        return "interpolation '${…}' is not supported; write the value out"
    return ""


def _key_lines(node: yaml.Node | None, keys: tuple[str, ...]) -> Iterable[tuple[tuple[str, ...], int]]:
    """Yields the keys that lead to each place below a YAML node, and its line counted from 1."""
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            here = (*keys, str(key.value))
            yield here, key.start_mark.line + 1
            yield from _key_lines(value, here)


def _container_from_yaml(text: str) -> Any:
    """Returns nested dictionaries and lists; OmegaConf refuses duplicate keys and reads 1e-4 as a number."""
    from omegaconf import OmegaConf

    return OmegaConf.to_container(OmegaConf.load(io.StringIO(text)), resolve=False)


def _dataclass_from_mapping(schema: type[T], data: Any, keys: tuple[str, ...]) -> T:
    """Returns an instance of a dataclass from a mapping of its fields."""
    if not isinstance(data, Mapping):
        raise _FieldError(keys, f"{_dotted(keys)}: expected a section of fields, got {_shown(data)}")
    data, kind = dict(data), tag_of(schema)
    if kind is not None and data.pop("kind", kind) != kind:
        raise _FieldError((*keys, "kind"), f"{_dotted((*keys, 'kind'))}: expected {kind!r}, the kind of this section")
    annotations = typing.get_type_hints(schema, include_extras=True)
    fields = {field.name: field for field in dataclasses.fields(schema) if field.init}  # type: ignore[arg-type]
    for key in data:
        if key not in fields:
            here = (*keys, str(key))
            names = [_dotted((*keys, name)) for name in (*fields, *_dotted_names(schema))]
            raise _FieldError(here, f"unknown key '{_dotted(here)}'{_nearest(_dotted(here), names)}")
    values = {name: _value_from(annotations[name], value, (*keys, name)) for name, value in data.items()}
    for name, field in fields.items():
        if name not in data and field.default is field.default_factory is dataclasses.MISSING:
            raise _FieldError(keys, f"missing field '{_dotted((*keys, name))}'; it has no default")
    try:
        return schema(**values)
    except ValueError as error:  # a config's own __post_init__ objects to a combination
        raise _FieldError(keys, f"{_dotted(keys)}: {error}" if keys else str(error)) from error


def _value_from(annotation: Any, value: Any, keys: tuple[str, ...]) -> Any:
    """Returns a value of an annotated type; nothing is coerced but whole numbers to float and lists to tuples."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated and isinstance(arguments[1], Tagged):
        return _value_from_tagged(arguments[1], value, keys)
    if dataclasses.is_dataclass(annotation):
        return _dataclass_from_mapping(typing.cast(type, annotation), value, keys)
    if origin in (Union, types.UnionType):
        return _value_from_union(annotation, value, keys)
    if origin is tuple and isinstance(value, list | tuple):
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            arguments = arguments[:1] * len(value)
        if len(arguments) == len(value):
            return tuple(_value_from(argument, item, keys) for argument, item in zip(arguments, value, strict=True))
    elif _is_scalar(annotation, value):
        return annotation(value) if annotation in (float, Path) else value
    raise _FieldError(keys, f"{_dotted(keys)}: expected {_described(annotation)}, got {_shown(value)}")


def _value_from_tagged(tagged: Tagged, value: Any, keys: tuple[str, ...]) -> Any:
    """Returns the config of a section whose `kind` names its class."""
    kind = value.get("kind") if isinstance(value, Mapping) else None
    if not isinstance(kind, str):
        raise _FieldError(keys, f"{_dotted(keys)}: expected a section with a field 'kind', got {_shown(value)}")
    try:
        schema = tagged.find(kind)
    except UserError as error:
        raise _FieldError((*keys, "kind"), f"{_dotted((*keys, 'kind'))}: {error}") from error
    return _dataclass_from_mapping(schema, value, keys)


def _value_from_union(annotation: Any, value: Any, keys: tuple[str, ...]) -> Any:
    """Returns a value of the first member of a union that it fits."""
    members = [member for member in typing.get_args(annotation) if member is not types.NoneType]
    if value is None and len(members) < len(typing.get_args(annotation)):
        return None
    if len(members) == 1:
        return _value_from(members[0], value, keys)
    for member in members:
        with contextlib.suppress(_FieldError):
            return _value_from(member, value, keys)
    raise _FieldError(keys, f"{_dotted(keys)}: expected {_described(annotation)}, got {_shown(value)}")


def _is_scalar(annotation: Any, value: Any) -> bool:
    """Returns whether a value may stand for a field of a scalar type; True is no number and NaN is none either."""
    if typing.get_origin(annotation) is Literal:
        return any(value == choice and type(value) is type(choice) for choice in typing.get_args(annotation))
    if annotation is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and not math.isnan(value)
    if annotation is Path:
        return isinstance(value, str | Path) and "${" not in str(value)
    if annotation is str:
        return isinstance(value, str) and "${" not in value
    return annotation in (bool, int) and type(value) is annotation


def _plain_from_value(value: Any) -> Any:
    """Returns a field's value as what YAML knows."""
    if dataclasses.is_dataclass(value):
        return config_to_dict(value)
    if isinstance(value, tuple | list):
        return [_plain_from_value(item) for item in value]
    return value.as_posix() if isinstance(value, Path) else value


def _described(annotation: Any) -> str:
    """Returns what a user would call the values of a type."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Literal:
        return f"one of {', '.join(repr(choice) for choice in arguments)}"
    if origin in (Union, types.UnionType):
        return " or ".join(_described(member) for member in arguments)
    if origin is tuple:
        items = arguments[:1] if arguments[-1] is Ellipsis else arguments
        return f"a list [{', '.join(_described(item) for item in items)}{', …' if arguments[-1] is Ellipsis else ''}]"
    names = {bool: "true or false", int: "a whole number", float: "a number", str: "text (in quotes if need be)"}
    return names.get(annotation, {Path: "a path", types.NoneType: "null"}.get(annotation, "a section of fields"))


def _dotted_names(schema: type) -> list[str]:
    """Returns the dotted names of all fields below a dataclass, sections left out."""
    names = []
    for name, annotation in typing.get_type_hints(schema).items():
        sections = [part for part in (annotation, *typing.get_args(annotation)) if dataclasses.is_dataclass(part)]
        below = [f"{name}.{field}" for section in sections for field in _dotted_names(typing.cast(type, section))]
        names += below or [name]
    return names


def _dotted(keys: tuple[str, ...]) -> str:
    """Returns the keys that lead to a field as it is written on the command line."""
    return ".".join(keys) or "the config"


def _nearest(name: str, known: Sequence[str]) -> str:
    """Returns the end of an error: the known name nearest to a wrong one, in whichever section it stands."""
    last_names = [choice.lstrip("-").rpartition(".")[2] for choice in known]
    found = difflib.get_close_matches(name.lstrip("-").rpartition(".")[2], last_names, n=1)
    if not found:
        return f"; known: {', '.join(known)}"
    places = [choice for choice, last_name in zip(known, last_names, strict=True) if last_name == found[0]]
    return f"; did you mean '{(difflib.get_close_matches(name, places, n=1) or places)[0]}'?"


def _shown(value: Any) -> str:
    """Returns a value for an error message, shortened."""
    text = "a section" if isinstance(value, Mapping) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


def _text_in_box(printed: str) -> str:
    """Returns in one line what tyro draws in a box: the part above the rule, which is followed by help texts."""
    rows = [row.strip("│ ") for row in printed.splitlines() if not row.startswith(("╭", "╰"))]
    above = next((index for index, row in enumerate(rows) if row and not row.strip("─")), len(rows))
    return " ".join(" ".join(rows[:above]).split()) or "cannot read the options"
