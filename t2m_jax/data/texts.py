"""Caption files of a data-set folder: one caption per line, as `caption#word/POS word/POS#from#to`."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_text
from t2m_jax.files.writing import save_text


class Caption(NamedTuple):
    """One sentence about a clip, or about the part from `start` to `end` (seconds) if one of them is not zero."""

    text: str
    tokens: tuple[str, ...] = ()
    start: float = 0.0
    end: float = 0.0

    @property
    def whole_clip(self) -> bool:
        """Whether the caption describes the whole clip (both times are zero)."""
        return self.start == 0.0 and self.end == 0.0


def _seconds(field: str, *, source: str) -> float:
    """Returns a time in seconds. `nan`, which HumanML3D has in some lines, counts as 0, as in the published loaders."""
    try:
        value = float(field)
    except ValueError:
        value = math.inf
    if math.isinf(value):
        raise UserError(f"{source}: '{field}' is not a time in seconds; write caption#tokens#from#to")
    return 0.0 if math.isnan(value) else value


def parse_caption(line: str, *, source: str) -> Caption:
    """Returns the caption on one line of a text file.

    Args:
        line: Four fields separated by `#`.
        source: `file:line` for error messages.

    Raises:
        UserError: The line does not have four fields, its caption is empty, or a time is not a number.
    """
    fields = line.rstrip("\r\n").split("#")
    if len(fields) != 4:
        raise UserError(
            f"{source}: {len(fields)} fields separated by '#', expected 4 (caption#tokens#from#to; tokens may be empty)"
        )
    text, tokens, start, end = (field.strip() for field in fields)
    if not text:
        raise UserError(f"{source}: the caption is empty; write one or remove the line")
    return Caption(text, tuple(tokens.split()), _seconds(start, source=source), _seconds(end, source=source))


def format_caption(caption: Caption) -> str:
    """Returns the line for one caption, without the line end.

    Raises:
        UserError: The caption or a token contains `#` or a line break.
    """
    tokens = " ".join(caption.tokens)
    if any(mark in caption.text + tokens for mark in "#\n\r"):
        raise UserError(f"caption {caption.text!r}: the text format cannot store '#' or a line break; remove it")
    return f"{caption.text}#{tokens}#{caption.start}#{caption.end}"


class CaptionFile(NamedTuple):
    """The captions of a text file, and one message per broken line, which begins with `file:line`."""

    captions: tuple[Caption, ...]
    problems: tuple[str, ...]


def read_captions(path: Path) -> CaptionFile:
    """Returns the captions and the broken lines of a text file, both in order. Blank lines are skipped.

    Raises:
        UserError: The file is missing or is not UTF-8.
    """
    captions = []
    problems = []
    # Not `splitlines`, which also divides lines at rare characters that a caption may contain.
    for number, line in enumerate(load_text(path).split("\n"), start=1):
        if not line.strip():
            continue
        try:
            captions.append(parse_caption(line, source=f"{path}:{number}"))
        except UserError as error:
            problems.append(str(error))
    return CaptionFile(tuple(captions), tuple(problems))


def load_captions(path: Path) -> tuple[Caption, ...]:
    """Returns all captions of a text file in order. Blank lines are skipped.

    Raises:
        UserError: The file is missing, is not UTF-8, or has a broken line, which the message names as `file:line`.
    """
    captions, problems = read_captions(path)
    if problems:
        raise UserError(problems[0])
    return captions


def save_captions(path: Path, captions: Sequence[Caption]) -> None:
    """Writes a caption file."""
    save_text(path, "".join(format_caption(caption) + "\n" for caption in captions))
