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


class _HierarchyParser:
    """Reads the words of the section one after another. Errors name the file and the line."""

    def __init__(self, lines: Sequence[str], path: Path):
        self._path = path
        # Braces are words of their own, also if no space is around them.
        numbered = enumerate((re.findall(r"[{}]|[^\s{}]+", line) for line in lines), start=1)
        self._words = [(word, number) for number, words in numbered for word in words]
        self._words.append(("", max(len(lines), 1)))  # the end
        self._next = 0
        self.names: list[str] = []
        self.parents: list[int] = []
        self.offsets: list[tuple[float, ...]] = []
        self.channels: list[tuple[str, ...]] = []

    def error(self, message: str) -> UserError:
        """Returns the error to raise for the line of the last word that was read."""
        return UserError(f"{self._path}:{self._words[self._next - 1][1]}: {message}")

    def peek(self) -> str:
        """Returns the next word, or an empty string at the end of the section."""
        return self._words[self._next][0]

    def take(self, expected: str) -> str:
        """Reads and returns the next word. `expected` describes it in the error."""
        self._next += 1
        word = self._words[self._next - 1][0]
        if not word:
            raise self.error(f"the HIERARCHY section ends where {expected} should follow; is the file truncated?")
        return word

    def take_word(self, word: str) -> None:
        """Reads the next word, which must be `word` in upper or lower case."""
        if (found := self.take(f'"{word}"')).upper() != word.upper():
            raise self.error(f'expected "{word}", found "{found}"')

    def take_number(self, field: str) -> float:
        """Reads and returns a finite number."""
        word = self.take(f"a number of {field}")
        try:
            value = float(word)
        except ValueError:
            raise self.error(f'{field}: "{word}" is not a number') from None
        if not abs(value) < MAX_VALUE:  # also refuses NaN, with which every comparison is False
            raise self.error(f"{field}: {word} is not a finite number below {MAX_VALUE:g}")
        return value

    def take_name(self, keyword: str) -> str:
        """Reads and returns the joint name that follows `keyword` on its line. It may contain spaces."""
        line = self._words[self._next - 1][1]
        words = []
        while self._words[self._next][1] == line and self.peek() not in ("{", "}", ""):
            words.append(self.take("a name"))
        if not words:
            raise self.error(f"{keyword} is not followed by a joint name")
        return " ".join(words)

    def take_offset(self, field: str) -> tuple[float, ...]:
        """Reads and returns an OFFSET."""
        self.take_word("OFFSET")
        return tuple(self.take_number(field) for _ in AXES)

    def open_joint(self, keyword: str, *, parent: int) -> int:
        """Reads a joint from its name to its channels and returns its index. The keyword was read before."""
        joint = self.take_name(keyword)
        if len(self.names) == MAX_JOINTS:
            raise self.error(f"the figure has more than {MAX_JOINTS:,} joints")
        # Rigs are found by names, so two joints of one name could not be told apart.
        if joint in self.names:
            raise self.error(f'joint name "{joint}" appears twice; names must be unique')
        self.take_word("{")
        self.names.append(joint)
        self.parents.append(parent)
        self.offsets.append(self.take_offset(f'OFFSET of "{joint}"'))
        self.channels.append(self.take_channels(joint) if self.peek().upper() == "CHANNELS" else ())
        return len(self.names) - 1

    def take_channels(self, joint: str) -> tuple[str, ...]:
        """Reads and returns the channels of a joint."""
        self.take_word("CHANNELS")
        count = self.take_number(f'CHANNELS of "{joint}"')
        if count not in range(7):
            raise self.error(f'CHANNELS of "{joint}": the count is {count:g}, it must be 0 to 6')
        channels: list[str] = []
        for _ in range(int(count)):
            spelling = self.take(f'a channel of "{joint}"')
            name = _CHANNEL_SPELLINGS.get(spelling.lower())
            if name is None:
                known = ", ".join(_CHANNEL_SPELLINGS.values())
                raise self.error(f'joint "{joint}": unknown channel "{spelling}"; known are {known}')
            if name in channels:
                raise self.error(f'joint "{joint}": channel {name} appears twice')
            channels.append(name)
        return tuple(channels)


def parse_hierarchy(lines: Sequence[str], path: Path) -> Hierarchy:
    """Returns the joints described by `lines`, the file from its first line to MOTION.

    Args:
        lines: Lines of text. The first one is line 1 of the file.
        path: The file, for error messages.
    """
    parser = _HierarchyParser(lines, path)
    parser.take_word("HIERARCHY")
    parser.take_word("ROOT")
    stack = [parser.open_joint("ROOT", parent=-1)]
    end_sites: dict[int, tuple[float, ...]] = {}
    note = ""
    while stack:  # no recursion, because a chain can be longer than Python's stack
        word = parser.take('"JOINT", "End Site" or "}"')
        match word.upper():
            case "JOINT":
                stack.append(parser.open_joint(word, parent=stack[-1]))
            case "END":
                # Files of this package have the captions of their parts here (see `part_captions`).
                name = parser.take_name(word)
                note = note or name.partition(" ")[2]
                parser.take_word("{")
                # A joint may have several End Sites; the first one is the tip.
                end_sites.setdefault(stack[-1], parser.take_offset("OFFSET of End Site"))
                parser.take_word("}")
            case "}":
                stack.pop()
            case _:
                joint = parser.names[stack[-1]]
                raise parser.error(f'joint "{joint}": expected "JOINT", "End Site" or "}}", found "{word}"')
    if parser.peek():
        found = parser.take("the end")
        kind = "a second ROOT; one figure per file" if found.upper() == "ROOT" else f'"{found}"'
        raise parser.error(f"after the closing brace of the root follows {kind}")
    offsets = np.array(parser.offsets, dtype=np.float64)
    channels = tuple(parser.channels)
    return Hierarchy(tuple(parser.names), tuple(parser.parents), offsets, channels, end_sites, note)
