"""YAML files of plain values, read without trusting them: nothing in a file can run code or grow."""

import re
import reprlib
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from t2m_jax.errors import UserError

MAX_FILE_BYTES = 100_000
"""Largest config file that is read. Real files have a few kB; PyYAML needs seconds for a megabyte."""
MAX_DEPTH = 32
"""Deepest nesting that is read. It bounds every recursion over a file."""
MAX_BITS = 10_000
"""Largest size of a whole number, about 3000 digits."""
GIVEN = ("/dev/", "/proc/")
"""Folders of pipes that users give on purpose, as with `<(command)` in a shell. Reading others may never end."""


class YamlFile(NamedTuple):
    """The contents of a YAML file."""

    data: dict[Any, Any]
    """Nested dictionaries, lists, numbers, strings, booleans and None; empty for an empty file."""
    lines: dict[tuple[str, ...], int]
    """The line of every key, counted from 1, by the keys that lead to it."""


def load_yaml(path: str | Path, *, max_bytes: int = MAX_FILE_BYTES) -> YamlFile:
    """Returns the contents of a YAML file of `field: value` lines.

    Raises:
        UserError: The file is missing, too large or not YAML, or it uses a feature of YAML that is not needed here.
    """
    path = Path(path)
    if not path.exists():
        raise UserError(f"{path}: no such config file")
    if path.is_dir():
        raise UserError(f"{path}: is a folder; give a YAML file")
    if not path.is_file() and not str(path).startswith(GIVEN):
        raise UserError(f"{path}: is a pipe or device; give a YAML file")
    if path.stat().st_size > max_bytes:
        raise UserError(f"{path}: is larger than {max_bytes // 1000} kB; give a config file")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: not a text file in UTF-8 (byte {error.start})") from error
    return parse_yaml(text, source=str(path))


def parse_yaml(text: str, *, source: str) -> YamlFile:
    """Returns the contents of `field: value` lines.

    Args:
        text: The lines; who calls this bounds their size.
        source: What messages name.

    Raises:
        UserError: This is not YAML, or it uses a feature of YAML that is not needed here.
    """
    try:
        loader = _Loader(text)
        root = loader.get_single_node()
        return YamlFile({} if root is None else loader.construct_document(root), _key_lines(root, ()))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{source}:{mark.line + 1}" if mark else source
        raise UserError(f"{where}: cannot read this YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, ValueError) as error:  # numbers such as 0b_ or of 5000 digits raise ValueError
        raise UserError(f"{source}: cannot read this YAML: {' '.join(str(error).split())}") from error


def yaml_text(data: dict[str, Any]) -> str:
    """Returns plain values as YAML that `load_yaml` reads back to equal values."""
    # PyYAML escapes characters outside ASCII. It can write them as they are, but then loses some line breaks (U+0085).
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=False)


class _Loader(yaml.SafeLoader):
    """Reads values and nothing else: no anchors, aliases, tags, interpolation or duplicate keys."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Returns the next node; problems are refused here, before anything can expand them."""
        event = self.peek_event()
        problem = ""
        if self.depth > MAX_DEPTH:
            problem = f"nested deeper than {MAX_DEPTH} levels"
        elif isinstance(event, yaml.AliasEvent) or event.anchor:
            problem = "anchors and aliases (& and *) are not supported; write the value out"
        elif event.tag:
            problem = f"tags such as '{event.tag}' are not supported"
        elif isinstance(event, yaml.ScalarEvent) and "${" in event.value:
            problem = "interpolation '${…}' is not supported; write the value out"
        elif self.depth == 0 and not isinstance(event, yaml.MappingStartEvent):
            problem = "expected 'field: value' lines"
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        """Returns the dictionary of a section; YAML's own loader would keep the last of two equal keys."""
        seen = set()
        for key, _ in node.value:
            if str(key.value) in seen:
                problem = f"found duplicate key {reprlib.repr(key.value)}"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
            seen.add(str(key.value))
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        """Returns a whole number; Python reads huge ones in hexadecimal, but cannot print them in messages."""
        value = super().construct_yaml_int(node)
        if value.bit_length() > MAX_BITS:
            raise yaml.MarkedYAMLError(problem="whole number of too many digits", problem_mark=node.start_mark)
        return value


class _Dumper(yaml.SafeDumper):
    """Writes what `_Loader` reads: it puts text such as 1e-4 in quotes."""


# PyYAML follows YAML 1.1, where 1e-4 is text, and dates, `<<` and `=` are not. Configs need numbers and text only.
_EXPONENT = re.compile(r"[-+]?[0-9][0-9_]*\.?[0-9_]*[eE][-+]?[0-9]+\Z")
_Loader.yaml_implicit_resolvers = {
    start: [(tag, pattern) for tag, pattern in resolvers if tag.endswith((":null", ":bool", ":int", ":float"))]
    for start, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)
for _class in (_Loader, _Dumper):
    _class.add_implicit_resolver("tag:yaml.org,2002:float", _EXPONENT, list("-+.0123456789"))


def _key_lines(node: yaml.Node | None, keys: tuple[str, ...]) -> dict[tuple[str, ...], int]:
    """Returns the line of every key below a YAML node, counted from 1."""
    lines: dict[tuple[str, ...], int] = {}
    for key, value in node.value if isinstance(node, yaml.MappingNode) else ():
        here = (*keys, str(key.value))
        lines |= {here: key.start_mark.line + 1} | _key_lines(value, here)
    return lines
