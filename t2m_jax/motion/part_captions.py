"""Where sentences begin in a motion, as files say it: what is read is checked, because a file may say anything."""

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

MAX_PARTS = 1000
"""Sentences of a motion that are read from a file. A motion of this many would take an hour."""
MAX_CAPTION = 1000
"""Characters of a sentence that are read from a file, as many as a prompt can have."""

Parts = tuple[tuple[int, str], ...]
"""First frame and text of each sentence."""

_MARK = re.compile(r'[;#] frame (\d{1,9}) \(\d{1,9}\.\d\d s\): ("(?:[^"\\]|\\.)*")')
_BRACES = str.maketrans({"{": r"\u007b", "}": r"\u007d"})


def with_neighbors(captions: Sequence[str]) -> tuple[str, ...]:
    """Returns sentences in which an empty one is that before it, or else that after it."""
    filled = list(captions)
    for place in range(1, len(filled)):
        filled[place] = filled[place] or filled[place - 1]
    for place in reversed(range(len(filled) - 1)):
        filled[place] = filled[place] or filled[place + 1]
    return tuple(filled)


def part_fields(parts: Mapping[int, str]) -> dict[str, Any]:
    """Returns the fields of a motion with these sentences by first frame; one from the beginning needs no parts."""
    fields: dict[str, Any] = {"caption": ", then ".join(filter(None, parts.values()))}
    if list(parts) == [0]:
        parts = {}
    return fields | {"part_starts": tuple(parts), "part_captions": tuple(parts.values())}


def fields_within(parts: Mapping[int, str], first: int, last: int) -> dict[str, Any]:
    """Returns the fields of the frames from `first` to before `last`: with the sentences that are shown there."""
    # Of those that begin before, the last one goes on.
    shown = {max(start - first, 0): text for start, text in parts.items() if start < last}
    fields = part_fields(shown)
    if len(shown) == len(parts):
        del fields["caption"]  # a motion may have another one than its sentences
    return fields


def parts_note(parts: Parts, *, fps: float) -> str:
    """Returns a line of printable ASCII without braces, such as `# frame 0 (0.00 s): "a"; frame 40 (2.00 s): "b"`."""
    # Braces are structure in BVH files, so they are written as JSON escapes.
    marks = [f"frame {first} ({first / fps:.2f} s): {json.dumps(text).translate(_BRACES)}" for first, text in parts]
    return "# " + "; ".join(marks)


def parts_from_note(note: str, *, num_frames: int) -> Parts:
    """Returns the parts of `parts_note`; none if a note says something else."""
    starts = []
    captions = []
    place = 0
    while found := _MARK.match(note, place):
        try:
            captions.append(json.loads(found[2]))
        except ValueError:  # an escape that JSON does not have
            return ()
        starts.append(int(found[1]))
        place = found.end()
    return checked_parts(starts, captions, num_frames=num_frames)


def checked_parts(starts: Any, captions: Any, *, num_frames: int) -> Parts:
    """Returns the parts that a file says a motion of some frames has; none if it cannot have them.

    Of captions, what cannot be printed becomes a space. Captions and their number are cut.
    """
    if not (isinstance(starts, Sequence) and isinstance(captions, Sequence) and len(starts) == len(captions)):
        return ()
    last = -1
    parts = []
    for first, text in zip(starts[:MAX_PARTS], captions, strict=False):
        if type(first) is not int or not isinstance(text, str) or not last < first < num_frames:
            return ()
        shown = "".join(letter if letter.isprintable() else " " for letter in text[:MAX_CAPTION])
        parts.append((first, " ".join(shown.split())))
        last = first
    return tuple(parts)
