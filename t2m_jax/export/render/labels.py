"""Captions in rendered pictures: in Pillow's own font, or in one of this machine that has more characters."""

import bisect
import contextlib
import functools
import logging
import unicodedata
from collections.abc import Callable

from PIL import Image, ImageDraw, ImageFont

logger = logging.getLogger(__name__)

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont

FONTS = (
    *("DejaVuSans.ttf", "NotoSans-Regular.ttf", "arial.ttf", "Arial Unicode.ttf", "NotoSansCJK-Regular.ttc"),
    *("DroidSansFallbackFull.ttf", "wqy-zenhei.ttc", "wqy-microhei.ttc", "msyh.ttc", "msgothic.ttc", "malgun.ttf"),
    *("Hiragino Sans GB.ttc", "AppleSDGothicNeo.ttc"),
)
"""Files of fonts that Linux, Windows and macOS have. Pillow knows in which folders."""
NO_GLYPH = "\U0010ffff"
"""A character that no font has."""
TEXT = (29, 37, 48, 255)
PANEL = (255, 255, 255, 205)
ELLIPSIS = "…"


def make_label(caption: str, *, size: int, width: int, max_lines: int) -> Image.Image | None:
    """Returns the caption on a rounded panel, or None if the caption is empty.

    Args:
        caption: Any text. Runs of white space become one space, and text that does not fit ends in an ellipsis.
        size: Height of the letters in pixels.
        width: Largest width of the panel in pixels.
        max_lines: Largest number of lines.
    """
    font, caption = find_font(" ".join(caption.split()), size)
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


@functools.lru_cache(maxsize=64)
def find_font(text: str, size: int) -> tuple[Font, str]:
    """Returns a font, and the text in characters that it has: Pillow's own font if it can, else one of `FONTS`.

    If no font has all characters, accents are removed, and a warning names the characters that are missing.
    """
    own = ImageFont.load_default(size)
    composed = unicodedata.normalize("NFC", text)
    for name in ("", *FONTS):
        with contextlib.suppress(OSError):  # there is no such font here
            font = ImageFont.truetype(name, size) if name else own
            if not missing_characters(font, composed):
                return font, composed
    plain = "".join(letter for letter in unicodedata.normalize("NFKD", text) if not unicodedata.combining(letter))
    if missing := missing_characters(own, plain):
        logger.warning("captions in pictures: no font on this machine has %s; install Noto Sans CJK", missing[:20])
    return own, plain


def missing_characters(font: Font, text: str) -> str:
    """Returns the characters of a text that a font does not have."""
    box = bytes(font.getmask(NO_GLYPH))
    letters = filter(str.isprintable, dict.fromkeys(text))
    return "".join(letter for letter in letters if bytes(font.getmask(letter)) == box)


def wrap(text: str, measure: Callable[[str], float], *, width: float, max_lines: int) -> list[str]:
    """Returns the text in lines that are not wider than `width`. An ellipsis replaces what does not fit.

    Words longer than a line are split.
    """
    printable = "".join(letter if letter.isprintable() else " " for letter in text)
    rest = " ".join(printable.split())
    lines: list[str] = []
    while rest and len(lines) <= max_lines:
        # The longest prefix that fits, by binary search; at least one letter.
        end = max(1, bisect.bisect_right(range(1, len(rest) + 1), width, key=lambda n: measure(rest[:n])))
        if end < len(rest) and (space := rest.rfind(" ", 0, end + 1)) > 0:
            end = space
        lines.append(rest[:end].rstrip())
        rest = rest[end:].lstrip()
    if len(lines) <= max_lines:
        return lines
    last = lines[max_lines - 1]
    while last and measure(last + ELLIPSIS) > width:
        last = last[:-1]
    return [*lines[: max_lines - 1], last.rstrip() + ELLIPSIS]
