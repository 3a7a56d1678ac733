"""The MOTION section of a BVH file: the number of frames, the frame time and the channel values."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.rig.clip import MAX_VALUE

_NUMBER_BYTES = np.zeros(256, dtype=bool)
_NUMBER_BYTES[list(b"0123456789+-.eE \t\r\n\f\v")] = True
_LINE_END = ord("\n")
_BLANK = ord(" ")
_RATE_TOLERANCE = 0.015  # 0.033 seconds are 30 frames per second, but 0.08 seconds are not 12


class MotionTable(NamedTuple):
    """The numbers of the section, one row per frame."""

    values: Float[np.ndarray, "T C"]
    fps: float


def parse_motion(text: bytes, path: Path, *, first_line: int, num_channels: int) -> MotionTable:
    """Returns the table that follows the word MOTION.

    Args:
        text: The file after the line MOTION.
        path: The file, for error messages.
        first_line: Line number of the start of `text`.
        num_channels: Number of columns according to the hierarchy.
    """
    count, text, line = _read_field(text, path, line=first_line, field="Frames", content="count")
    if not re.fullmatch(r"[0-9]{1,9}", count) or int(count) == 0:
        raise UserError(f'{path}:{line}: bad frame count "{count}"; it must be a whole number of at least 1')
    num_frames = int(count)
    seconds, text, line = _read_field(text, path, line=line + 1, field="Frame Time", content="seconds")
    fps = _frame_rate(seconds, path, line=line)
    if num_channels == 0:
        raise UserError(f"{path}:{line}: the hierarchy has no channels, so there is no motion to read")
    first_row = line + 1
    row_lines = _check_layout(text, path, first_row=first_row, num_frames=num_frames, num_channels=num_channels)
    try:
        numbers = np.fromstring(text, dtype=np.float64, sep=" ")
    except ValueError:
        raise _bad_word(text, path, first_row) from None
    if numbers.size != num_frames * num_channels:  # NumPy reads "1-2" as two numbers, but it is one word
        raise _bad_word(text, path, first_row)
    values = numbers.reshape(num_frames, num_channels)
    bad = np.flatnonzero(~(np.abs(values) < MAX_VALUE).all(axis=1))
    if bad.size:
        raise UserError(f"{path}:{first_row + row_lines[bad[0]]}: a value is not a finite number below {MAX_VALUE:g}")
    return MotionTable(values=values, fps=fps)


def _read_field(text: bytes, path: Path, *, line: int, field: str, content: str) -> tuple[str, bytes, int]:
    """Returns the value of a line such as `Frames: 10`, the text after this line, and its number."""
    rest = text.lstrip()
    line += text[: len(text) - len(rest)].count(b"\n")
    if not rest:
        message = f'the MOTION section ends where "{field}:" should follow; is the file truncated?'
        raise UserError(f"{path}:{line}: {message}")
    head, _, text = rest.partition(b"\n")
    words = head[:200].decode("utf-8", errors="replace").strip()
    found = re.fullmatch(field.replace(" ", r"\s*") + r"\s*:\s*(\S+)", words, flags=re.IGNORECASE)
    if not found:
        raise UserError(f'{path}:{line}: expected "{field}: <{content}>", found "{words[:40]}"')
    return found[1], text, line


def _frame_rate(text: str, path: Path, *, line: int) -> float:
    """Returns frames per second: a whole number if the rounded frame time means one (0.0333333 is 30)."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = np.nan
    if not 1e-4 <= seconds <= 1:
        raise UserError(f'{path}:{line}: bad frame time "{text}"; it must be seconds per frame, 0.0001 to 1')
    # Frame times have few digits, so 0.0333 means 30 and not 30.03 frames per second.
    nearest = max(round(1 / seconds), 1)
    decimals = len(text.partition(".")[2]) if "e" not in text.lower() else 9
    same_digits = round(1 / nearest, decimals) == round(seconds, decimals)
    close = abs(nearest * seconds - 1) < _RATE_TOLERANCE
    return float(nearest) if same_digits and close else 1 / seconds


def _check_layout(text: bytes, path: Path, *, first_row: int, num_frames: int, num_channels: int) -> np.ndarray:
    """Returns the line index of each row. Raises an error unless the text is a table of the expected size.

    Words are counted per line on the raw bytes. Then all numbers are parsed at once, and a row that lacks a value
    cannot take one from the next row.
    """
    raw = np.frombuffer(text, dtype=np.uint8)
    if not _NUMBER_BYTES[raw].all():
        raise _bad_word(text, path, first_row)
    inside = np.concatenate(([False], raw > _BLANK, [False]))
    starts = np.flatnonzero(inside[1:-1] & ~inside[:-2])
    line_of_word = np.searchsorted(np.flatnonzero(raw == _LINE_END), starts)
    row_lines, columns = np.unique(line_of_word, return_counts=True)
    wrong = np.flatnonzero(columns != num_channels)
    if wrong.size and wrong[0] < num_frames:
        row = int(wrong[0])
        hint = "; is the file truncated?" if row == len(columns) - 1 else ""
        raise UserError(
            f"{path}:{first_row + row_lines[row]}: frame {row} has {columns[row]} columns, "
            f"but the hierarchy has {num_channels} channels{hint}"
        )
    if len(columns) < num_frames:
        line = first_row + (int(row_lines[-1]) if len(columns) else 0)
        message = f"the file ends after {len(columns)} of {num_frames} frames; is it truncated?"
        raise UserError(f"{path}:{line}: {message}")
    if len(columns) > num_frames:
        message = f"data after the last frame; the header says {num_frames} frames, but there are {len(columns)}"
        raise UserError(f"{path}:{first_row + row_lines[num_frames]}: {message}")
    return row_lines


def _bad_word(text: bytes, path: Path, first_row: int) -> UserError:
    """Returns the error for the first word that is not a finite number."""
    for line, row in enumerate(text.split(b"\n"), start=first_row):
        for word in row.split():
            shown = word[:24].decode("utf-8", errors="replace")
            try:
                finite = np.isfinite(float(word))
            except ValueError:
                return UserError(f'{path}:{line}: "{shown}" is not a number')
            if not finite:
                return UserError(f"{path}:{line}: {shown} is not a finite number")
            if b"_" in word:  # Python accepts 1_000, but the format does not
                return UserError(f'{path}:{line}: "{shown}" is not a number')
    return UserError(f"{path}:{first_row}: the frames contain something that is not a number")
