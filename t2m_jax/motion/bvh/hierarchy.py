"""The HIERARCHY section of a BVH file: names, parents, offsets and channels of the joints."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.rig.clip import MAX_JOINTS, MAX_VALUE

AXES = "XYZ"
POSITION_CHANNELS = tuple(f"{axis}position" for axis in AXES)
ROTATION_CHANNELS = tuple(f"{axis}rotation" for axis in AXES)
_CHANNEL_SPELLINGS = {name.lower(): name for name in POSITION_CHANNELS + ROTATION_CHANNELS}


class Hierarchy(NamedTuple):
    """The joints of a BVH file in their order in the file. Lengths are in the file's unit."""

    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Float[np.ndarray, "J 3"]
    channels: tuple[tuple[str, ...], ...]
    end_sites: dict[int, tuple[float, ...]]
    """Joint -> OFFSET of its first End Site."""
    note: str = ""
    """What follows the words `End Site` on the first of their lines where something does."""

    @property
    def num_channels(self) -> int:
        """Number of columns of the MOTION section."""
        return sum(len(names) for names in self.channels)


class _Token(NamedTuple):
    text: str
    line: int


class _Tokens:
    """The words of the section, read one after another. Errors name the file and the line."""

    def __init__(self, lines: Sequence[str], path: Path):
        self._path = path
        self._tokens = [
            _Token(word, number)
            for number, line in enumerate(lines, start=1)
            # Braces are words of their own, also if no space is around them.
            for word in re.findall(r"[{}]|[^\s{}]+", line)
        ]
        self._last_line = max(len(lines), 1)
        self._next = 0

    def error(self, message: str, *, line: int | None = None) -> UserError:
        """Returns the error to raise for `line`, by default the line of the last word that was read."""
        if line is None:
            line = self._tokens[self._next - 1].line if self._next else 1
        return UserError(f"{self._path}:{line}: {message}")

    def peek(self) -> str:
        """Returns the next word, or an empty string at the end of the section."""
        return self._tokens[self._next].text if self._next < len(self._tokens) else ""

    def take(self, expected: str) -> _Token:
        """Reads and returns the next word. `expected` describes it in the error."""
        if self._next == len(self._tokens):
            message = f"the HIERARCHY section ends where {expected} should follow; is the file truncated?"
            raise self.error(message, line=self._last_line)
        self._next += 1
        return self._tokens[self._next - 1]

    def take_word(self, word: str) -> None:
        """Reads the next word, which must be `word` in upper or lower case."""
        token = self.take(f'"{word}"')
        if token.text.upper() != word.upper():
            raise self.error(f'expected "{word}", found "{token.text}"')

    def take_number(self, field: str) -> float:
        """Reads and returns a finite number."""
        token = self.take(f"a number of {field}")
        try:
            value = float(token.text)
        except ValueError:
            raise self.error(f'{field}: "{token.text}" is not a number') from None
        if not abs(value) < MAX_VALUE:  # also refuses NaN, with which every comparison is False
            raise self.error(f"{field}: {token.text} is not a finite number below {MAX_VALUE:g}")
        return value

    def take_name(self, keyword: _Token) -> str:
        """Reads and returns the joint name that follows `keyword` on its line. It may contain spaces."""
        words = []
        while self._next < len(self._tokens):
            token = self._tokens[self._next]
            if token.line != keyword.line or token.text in "{}":
                break
            words.append(token.text)
            self._next += 1
        if not words:
            raise self.error(f"{keyword.text} is not followed by a joint name", line=keyword.line)
        return " ".join(words)


class _Draft(NamedTuple):
    """The joints that were read so far."""

    names: list[str]
    parents: list[int]
    offsets: list[tuple[float, ...]]
    channels: list[tuple[str, ...]]
    end_sites: dict[int, tuple[float, ...]]


def parse_hierarchy(lines: Sequence[str], path: Path) -> Hierarchy:
    """Returns the joints described by `lines`, the file from its first line to MOTION.

    Args:
        lines: Lines of text. The first one is line 1 of the file.
        path: The file, for error messages.
    """
    tokens = _Tokens(lines, path)
    tokens.take_word("HIERARCHY")
    draft = _Draft([], [], [], [], {})
    root = tokens.take('"ROOT"')
    if root.text.upper() != "ROOT":
        raise tokens.error(f'expected "ROOT", found "{root.text}"')
    stack = [_open_joint(tokens, draft, keyword=root, parent=-1)]
    note = ""
    while stack:  # no recursion, because a chain can be longer than Python's stack
        token = tokens.take('"JOINT", "End Site" or "}"')
        match token.text.upper():
            case "JOINT":
                stack.append(_open_joint(tokens, draft, keyword=token, parent=stack[-1]))
            case "END":
                name = tokens.take_name(token)
                # Files of this package have the captions of their parts here (see `part_captions`).
                note = note or name.partition(" ")[2]
                tokens.take_word("{")
                # A joint may have several End Sites; the first one is the tip.
                draft.end_sites.setdefault(stack[-1], _read_offset(tokens, "OFFSET of End Site"))
                tokens.take_word("}")
            case "}":
                stack.pop()
            case _:
                joint = draft.names[stack[-1]]
                raise tokens.error(f'joint "{joint}": expected "JOINT", "End Site" or "}}", found "{token.text}"')
    if tokens.peek():
        found = tokens.take("the end")
        kind = "a second ROOT; one figure per file" if found.text.upper() == "ROOT" else f'"{found.text}"'
        raise tokens.error(f"after the closing brace of the root follows {kind}")
    offsets = np.array(draft.offsets, dtype=np.float64)
    return Hierarchy(tuple(draft.names), tuple(draft.parents), offsets, tuple(draft.channels), draft.end_sites, note)


def _open_joint(tokens: _Tokens, draft: _Draft, *, keyword: _Token, parent: int) -> int:
    """Reads a joint from its name to its channels and returns its index. The keyword was read before."""
    joint = tokens.take_name(keyword)
    if len(draft.names) == MAX_JOINTS:
        raise tokens.error(f"the figure has more than {MAX_JOINTS:,} joints", line=keyword.line)
    # Rigs are found by names, so two joints of one name could not be told apart.
    if joint in draft.names:
        raise tokens.error(f'joint name "{joint}" appears twice; names must be unique')
    tokens.take_word("{")
    draft.names.append(joint)
    draft.parents.append(parent)
    draft.offsets.append(_read_offset(tokens, f'OFFSET of "{joint}"'))
    channels: list[str] = []
    if tokens.peek().upper() == "CHANNELS":
        tokens.take_word("CHANNELS")
        count = tokens.take_number(f'CHANNELS of "{joint}"')
        if count not in range(7):
            raise tokens.error(f'CHANNELS of "{joint}": the count is {count:g}, it must be 0 to 6')
        for _ in range(int(count)):
            spelling = tokens.take(f'a channel of "{joint}"').text
            name = _CHANNEL_SPELLINGS.get(spelling.lower())
            if name is None:
                known = ", ".join(_CHANNEL_SPELLINGS.values())
                raise tokens.error(f'joint "{joint}": unknown channel "{spelling}"; known are {known}')
            if name in channels:
                raise tokens.error(f'joint "{joint}": channel {name} appears twice')
            channels.append(name)
    draft.channels.append(tuple(channels))
    return len(draft.names) - 1


def _read_offset(tokens: _Tokens, field: str) -> tuple[float, ...]:
    tokens.take_word("OFFSET")
    return tuple(tokens.take_number(field) for _ in AXES)
