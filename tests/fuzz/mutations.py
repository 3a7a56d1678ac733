"""Changes of files: random ones of their bytes, their numbers and, for archives, of what is in them."""

import io
import random
import re
import struct
import zipfile
from collections.abc import Callable

TOKENS = (
    *(b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\n", b"\r", b"\t", b" ", b"#", b",", b":", b'"', b"'", b"\\", b"/"),
    *(
        b"{",
        b"}",
        b"[",
        b"]",
        b"<",
        b"&a",
        b"*a",
        b"!!python/name:os.system",
        b"null",
        b"true",
        b"---\n",
        b"../",
        b"\x1b[31m",
    ),
    *(b"nan", b"inf", b"-0.0", b"-1", b"0", b"1e309", b"1e-320", b"0x10", b"2020-13-45", b"9" * 25, b"9" * 5000),
)
"""Text that means something in one of the formats, or that a parser may not expect."""
NUMBER = re.compile(rb"-?\d+(\.\d+)?(e-?\d+)?")
WORDS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
"""Whole numbers at the limits of their types."""


def _place(data: bytearray, draws: random.Random) -> int:
    """Returns a place in the file; half of them are near the start, where a file says what the rest means."""
    return draws.randrange(min(len(data), draws.choice((200, len(data)))) or 1)


def _flip(data: bytearray, draws: random.Random) -> None:
    if data:
        data[_place(data, draws)] ^= 1 << draws.randrange(8)


def _cut(data: bytearray, draws: random.Random) -> None:
    first = _place(data, draws)
    del data[first : first + draws.choice((1, 4, 16, len(data)))]


def _repeat(data: bytearray, draws: random.Random) -> None:
    first = _place(data, draws)
    piece = data[first : first + draws.choice((1, 8, 64, 512))]
    data[first:first] = piece * draws.choice((1, 2, 30))


def _move(data: bytearray, draws: random.Random) -> None:
    first, size = _place(data, draws), draws.choice((1, 8, 64))
    piece = data[first : first + size]
    del data[first : first + size]
    place = _place(data, draws)
    data[place:place] = piece


def _insert(data: bytearray, draws: random.Random) -> None:
    place = _place(data, draws)
    data[place:place] = draws.choice(TOKENS)


def _word(data: bytearray, draws: random.Random) -> None:
    place, size = _place(data, draws), draws.choice("BHIQ")
    value = (draws.choice(WORDS) + draws.randint(-1, 1)) % 256 ** struct.calcsize(size)
    data[place : place + struct.calcsize(size)] = struct.pack(draws.choice("<>") + size, value)


def _number(data: bytearray, draws: random.Random) -> None:
    found = NUMBER.search(data, _place(data, draws))
    if found:
        data[slice(*found.span())] = draws.choice(TOKENS[-11:])


CHANGES: tuple[Callable[[bytearray, random.Random], None], ...] = (_flip, _cut, _repeat, _move, _insert, _word, _number)


def mutate(data: bytes, draws: random.Random) -> bytes:
    """Returns a file with one or several changes; in half of the cases, those of an archive are in one of its files."""
    if data.startswith(b"PK") and draws.random() < 0.5:
        return _mutate_archive(data, draws)
    changed = bytearray(data)
    for _ in range(draws.choice((1, 1, 1, 2, 4, 8))):
        draws.choice(CHANGES)(changed, draws)
    return bytes(changed)


def _mutate_archive(data: bytes, draws: random.Random) -> bytes:
    """Returns a ZIP archive whose checksums are right although one of its files is changed."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    name = draws.choice(sorted(files))
    files[name] = mutate(files[name], draws)
    result = io.BytesIO()
    with zipfile.ZipFile(result, "w", draws.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return result.getvalue()
