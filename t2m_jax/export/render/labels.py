"""Captions on rendered pictures, in the font that comes with Pillow."""

import unicodedata
from collections.abc import Callable

from PIL import Image, ImageDraw, ImageFont

TEXT = (29, 37, 48, 255)
PANEL = (255, 255, 255, 205)
ELLIPSIS = "…"


def make_label(caption: str, *, size: int, width: int, max_lines: int) -> Image.Image | None:
    """Returns the caption on a rounded panel at most `width` pixels wide, or None if there is nothing to say.

    Args:
        caption: Any text; white space is evened out, what does not fit ends in an ellipsis.
        size: Height of the letters, pixels.
        width: Most that the panel may take, pixels.
        max_lines: Most lines.
    """
    font = ImageFont.load_default(size)
    margin = round(0.7 * size)
    lines = wrap(caption, font.getlength, width=float(width - 2 * margin), max_lines=max_lines)
    if not lines:
        return None
    line_height = round(1.35 * size)
    text_width = max(font.getlength(line) for line in lines)
    panel = Image.new("RGBA", (round(text_width) + 2 * margin, line_height * len(lines) + margin))
    draw = ImageDraw.Draw(panel)
    draw.rounded_rectangle((0, 0, panel.width - 1, panel.height - 1), radius=round(0.55 * size), fill=PANEL)
    for number, line in enumerate(lines):
        middle = (panel.width / 2, margin / 2 + (number + 0.5) * line_height)
        draw.text(middle, line, font=font, fill=TEXT, anchor="mm")
    return panel


def wrap(text: str, measure: Callable[[str], float], *, width: float, max_lines: int) -> list[str]:
    """Returns the text in lines no wider than `width`, what does not fit into `max_lines` as an ellipsis.

    Words longer than a line are cut. Letters lose their accents, which the font does not have.
    """
    letters = (letter for letter in unicodedata.normalize("NFKD", text) if not unicodedata.combining(letter))
    printable = "".join(letter if letter.isprintable() else " " for letter in letters)
    lines: list[str] = []
    line = ""
    for word in printable.split():
        longer = f"{line} {word}".strip()
        if measure(longer) <= width:
            line = longer
            continue
        if line:
            lines.append(line)
        while measure(word) > width and len(lines) <= max_lines:
            length = _fitting(word, measure, width)
            lines.append(word[:length])
            word = word[length:]
        line = word
        if len(lines) > max_lines:
            break
    if line:
        lines.append(line)
    if len(lines) <= max_lines:
        return lines
    last = lines[max_lines - 1]
    while last and measure(last + ELLIPSIS) > width:
        last = last[:-1]
    return [*lines[: max_lines - 1], last.rstrip() + ELLIPSIS]


def _fitting(word: str, measure: Callable[[str], float], width: float) -> int:
    """Returns how many letters of a word fit, at least one."""
    low, high = 1, len(word)
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if measure(word[:middle]) <= width else (low, middle - 1)
    return low
