"""The MOTION section of a BVH file: frame count, frame time and the table of channel values."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError

_NUMBER_BYTES = np.zeros(256, dtype=bool)
_NUMBER_BYTES[list(b"0123456789+-.eE \t\r\n\f\v")] = True
_LINE_END = ord("\n")
_BLANK = ord(" ")
_RATE_TOLERANCE = 0.015  # 0.033 seconds are 30 frames per second, 0.08 are not 12


class MotionTable(NamedTuple):
    """The numbers of the section, one row a frame."""

    values: Float[np.ndarray, "T C"]
    fps: float


def parse_motion(text: bytes, path: Path, *, first_line: int, num_channels: int) -> MotionTable:
    """Returns the table that follows the word MOTION.

    Args:
        text: The file after the line MOTION.
        path: File to name in errors.
        first_line: Number of the first line of `text` in the file.
        num_channels: Columns that the hierarchy asks for.
    """
    frames_line, text, frames_number = _next_line(text, first_line, path, field="Frames")
    num_frames = _frame_count(frames_line, path, line=frames_number)
    time_line, text, time_number = _next_line(text, frames_number + 1, path, field="Frame Time")
    fps = _frame_rate(time_line, path, line=time_number)
    if num_channels == 0:
        raise UserError(f"{path}:{time_number}: the hierarchy has no channels, so there is no motion to read")
    first_row = time_number + 1
    row_lines = _check_layout(text, path, first_row=first_row, num_frames=num_frames, num_channels=num_channels)
    values = _parse_numbers(text, path, first_row=first_row, count=num_frames * num_channels)
    values = values.reshape(num_frames, num_channels)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if bad.size:
        raise UserError(f"{path}:{first_row + row_lines[bad[0]]}: a value is too large to be a finite number")
    return MotionTable(values=values, fps=fps)


def _next_line(text: bytes, line: int, path: Path, *, field: str) -> tuple[str, bytes, int]:
    """Returns the next line that is not empty, the text after it and its number."""
    while text:
        head, _, text = text.partition(b"\n")
        if head.strip():
            return head.decode("utf-8", errors="replace").strip(), text, line
        line += 1
    raise UserError(f'{path}:{line}: the MOTION section ends where "{field}:" should follow; is the file truncated?')


def _frame_count(line_text: str, path: Path, *, line: int) -> int:
    found = re.fullmatch(r"Frames\s*:\s*(\S+)", line_text, flags=re.IGNORECASE)
    if not found:
        raise UserError(f'{path}:{line}: expected "Frames: <count>", found "{line_text[:40]}"')
    if not re.fullmatch(r"[0-9]{1,9}", found[1]) or int(found[1]) == 0:
        raise UserError(f'{path}:{line}: bad frame count "{found[1]}"; it must be a whole number of at least 1')
    return int(found[1])


def _frame_rate(line_text: str, path: Path, *, line: int) -> float:
    """Returns frames per second; a whole number where the rounded time means one (0.0333333 is 30)."""
    found = re.fullmatch(r"Frame\s*Time\s*:\s*(\S+)", line_text, flags=re.IGNORECASE)
    if not found:
        raise UserError(f'{path}:{line}: expected "Frame Time: <seconds>", found "{line_text[:40]}"')
    try:
        seconds = float(found[1])
    except ValueError:
        seconds = np.nan
    if not 1e-4 <= seconds <= 10:
        raise UserError(f'{path}:{line}: bad frame time "{found[1]}"; it must be seconds per frame, 0.0001 to 10')
    nearest = max(round(1 / seconds), 1)
    decimals = len(found[1].partition(".")[2]) if "e" not in found[1].lower() else 9
    same_digits = round(1 / nearest, decimals) == round(seconds, decimals)
    close = abs(nearest * seconds - 1) < _RATE_TOLERANCE
    return float(nearest) if same_digits and close else 1 / seconds


def _check_layout(text: bytes, path: Path, *, first_row: int, num_frames: int, num_channels: int) -> np.ndarray:
    """Returns the line index of each row after refusing what is no table of numbers of the promised size.

    Words are counted per line on the raw bytes: the numbers are then parsed in one go, and a row that
    lacks a value cannot borrow it from the next.
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
            f"the hierarchy asks for {num_channels}{hint}"
        )
    if len(columns) < num_frames:
        line = first_row + (int(row_lines[-1]) if len(columns) else 0)
        message = f"the file ends after {len(columns)} of {num_frames} frames; is it truncated?"
        raise UserError(f"{path}:{line}: {message}")
    if len(columns) > num_frames:
        message = f"data after the last frame; the header promises {num_frames} frames, here are {len(columns)}"
        raise UserError(f"{path}:{first_row + row_lines[num_frames]}: {message}")
    return row_lines


def _parse_numbers(text: bytes, path: Path, *, first_row: int, count: int) -> Float[np.ndarray, " N"]:
    try:
        values = np.fromstring(text, dtype=np.float64, sep=" ")
    except ValueError:
        raise _bad_word(text, path, first_row) from None
    if values.size != count:  # "1-2" is two numbers to NumPy and one word to us
        raise _bad_word(text, path, first_row)
    return values


def _bad_word(text: bytes, path: Path, first_row: int) -> UserError:
    """Returns the error for the first word that is no finite number."""
    for line, row in enumerate(text.split(b"\n"), start=first_row):
        for word in row.split():
            shown = word[:24].decode("utf-8", errors="replace")
            try:
                finite = np.isfinite(float(word))
            except ValueError:
                return UserError(f'{path}:{line}: "{shown}" is not a number')
            if not finite:
                return UserError(f"{path}:{line}: {shown} is not a finite number")
            if b"_" in word:  # Python reads 1_000, the format does not
                return UserError(f'{path}:{line}: "{shown}" is not a number')
    return UserError(f"{path}:{first_row}: the frames hold something that is no number")
