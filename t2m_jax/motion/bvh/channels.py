"""The MOTION section of a BVH file: the number of frames, the frame time and the channel values."""

import contextlib
import re
from collections.abc import Sequence
from decimal import ROUND_DOWN, ROUND_HALF_EVEN, Decimal
from pathlib import Path

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.rig.clip import MAX_VALUE

_USUAL_RATES = (24, 25, 30, 48, 50, 60, 72, 90, 100, 120, 144, 240)
_USUAL_TOLERANCE = 0.025  # 0.017 seconds are 60 frames per second
_MOST_DIGITS = 20
_RATE_TOLERANCE = 0.015  # 0.033 seconds are 30 frames per second, but 0.08 seconds are not 12


def parse_motion(
    text: bytes, path: Path, *, first_line: int, num_channels: int
) -> tuple[Float[np.ndarray, "T C"], float]:
    """Returns the numbers that follow the word MOTION, one row per frame, and the frames per second.

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
    lines = [(number, row) for number, row in enumerate(text.split(b"\n"), first_row) if row.strip()]
    rows = _unwrapped(lines, shape=(num_frames, num_channels))
    values = np.zeros((0, 0))
    with contextlib.suppress(ValueError):  # a word is not a number, or rows have different lengths
        # Row by row, because lists of Python's numbers need four times the memory.
        values = np.array([np.array(list(map(float, row.split()))) for _, row in rows])
    # Python reads 1_000 as a number, but the format does not have it.
    if values.shape != (num_frames, num_channels) or not (np.abs(values) < MAX_VALUE).all() or b"_" in text:
        raise _problem([(first_row, b""), *rows], path, shape=(num_frames, num_channels))
    return values, fps


def _unwrapped(rows: Sequence[tuple[int, bytes]], *, shape: tuple[int, int]) -> Sequence[tuple[int, bytes]]:
    """Returns a row for each frame if all frames have several lines in the file; otherwise its lines."""
    num_frames, num_channels = shape
    if not rows or len(rows[0][1].split()) >= num_channels:
        return rows
    frames: list[tuple[int, list[bytes]]] = []
    count = num_channels
    for line, row in rows:
        if count == num_channels:
            frames.append((line, []))
            count = 0
        frames[-1][1].append(row)
        count += len(row.split())
        if count > num_channels:
            return rows
    if count < num_channels or len(frames) != num_frames:
        return rows
    return [(line, b" ".join(parts)) for line, parts in frames]


def _problem(rows: Sequence[tuple[int, bytes]], path: Path, *, shape: tuple[int, int]) -> UserError:
    """Returns the error for the first row that is not as the header and the hierarchy say; the frames begin at 1."""
    num_frames, num_channels = shape
    count = len(rows) - 1
    for frame, (line, row) in enumerate(rows[1:]):
        words = row.split()
        for word in words:
            shown = word[:24].decode("utf-8", errors="replace")
            value = None
            with contextlib.suppress(ValueError):
                value = float(word)
            if value is None or b"_" in word:
                return UserError(f'{path}:{line}: "{shown}" is not a number')
            if not abs(value) < MAX_VALUE:
                return UserError(f"{path}:{line}: {shown} is not a finite number below {MAX_VALUE:g}")
        if len(words) != num_channels:
            hint = "; is the file truncated?" if frame == count - 1 else ""
            have = f"frame {frame} has {len(words)} columns, but the hierarchy has {num_channels} channels{hint}"
            return UserError(f"{path}:{line}: {have}")
    if count < num_frames:
        return UserError(f"{path}:{rows[-1][0]}: the file ends after {count} of {num_frames} frames; is it truncated?")
    message = f"data after the last frame; the header says {num_frames} frames, but there are {count}"
    return UserError(f"{path}:{rows[num_frames + 1][0]}: {message}")


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


def _usual_rate(seconds: Decimal) -> float | None:
    """Returns the usual frame rate whose frame time, rounded or cut, is written so; None if there is none.

    A time that is that of a whole rate without rounding, as 0.008 is that of 125, means this rate.
    """
    exponent = int(seconds.as_tuple().exponent)
    if exponent < -_MOST_DIGITS or 1 % seconds == 0:
        return None
    last_digit = Decimal(1).scaleb(exponent)
    for rate in _USUAL_RATES:
        written = [(1 / Decimal(rate)).quantize(last_digit, rounding) for rounding in (ROUND_HALF_EVEN, ROUND_DOWN)]
        if seconds in written and abs(rate * seconds - 1) < _USUAL_TOLERANCE:
            return float(rate)
    return None


def _frame_rate(text: str, path: Path, *, line: int) -> float:
    """Returns frames per second: a whole number if the rounded frame time means one (0.0333333 is 30)."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = np.nan
    if not 1e-4 <= seconds <= 1:
        raise UserError(f'{path}:{line}: bad frame time "{text}"; it must be seconds per frame, 0.0001 to 1')
    # Frame times have few digits, so 0.0333 means 30 and not 30.03 frames per second, and 0.017 means 60 and not 59.
    if (usual := _usual_rate(Decimal(text))) is not None:
        return usual
    nearest = max(round(1 / seconds), 1)
    # Whether rounded or cut: 0.016666 means 60, too.
    last_digit = 10.0 ** int(Decimal(text).as_tuple().exponent)
    same_digits = abs(1 / nearest - seconds) < last_digit
    close = abs(nearest * seconds - 1) < _RATE_TOLERANCE
    return float(nearest) if same_digits and close else 1 / seconds
