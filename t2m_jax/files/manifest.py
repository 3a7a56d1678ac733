"""Manifests: the checksums of all files of a folder, in the folder itself.

A manifest is a text. Its first line names the format, then follows a line for each file with CRC-32, SHA-256, size in
bytes and name, sorted by name. The last line is the SHA-256 of the lines before it. There is only one way to write the
manifest of a folder, so that any change of a byte shows. A text that is written again and again needs no manifest: it
ends with its own checksum. JSON, which has no comments, has it as an entry.
"""

import hashlib
import json
import zlib
from collections.abc import Container, Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from t2m_jax.errors import UserError
from t2m_jax.files.reading import MAX_TEXT, load_bytes, load_json, load_text, reading
from t2m_jax.files.writing import save_json, save_text

MANIFEST = "manifest.txt"
CHECKSUM = "checksum"
"""Entry of a JSON file."""
_TITLE = "t2m_jax manifest 1"
_CHUNK = 4 * 2**20
_SEAL = "# SHA-256 of the lines above: "
"""Begins the last line, which is a comment in YAML."""


class Entry(NamedTuple):
    """What a manifest says of a file."""

    crc32: str
    sha256: str
    size: int


def write_manifest(folder: Path, patterns: Iterable[str] = ("**/*",)) -> None:
    """Writes the manifest of the files in a folder whose names fit a pattern, by default also in the folders in it."""
    found = {path for pattern in patterns for path in folder.glob(pattern) if path.is_file()} - {folder / MANIFEST}
    names = (path.relative_to(folder).as_posix() for path in found)
    save_text(folder / MANIFEST, _render({name: _measure(folder / name) for name in names}))


def has_manifest(folder: Path) -> bool:
    """Returns whether a folder has a manifest."""
    return (folder / MANIFEST).is_file()


def read_manifest(folder: Path) -> dict[str, Entry]:
    """Returns the manifest of a folder: its files by name.

    Raises:
        UserError: The manifest is missing or damaged.
    """
    path = folder / MANIFEST
    found = load_bytes(path, max_bytes=MAX_TEXT)
    try:
        fields = [line.split(" ", 3) for line in found.decode().split("\n")[1:-2]]
        entries = {name: Entry(crc32, sha256, int(size)) for crc32, sha256, size, name in fields}
    except ValueError:
        entries = {}
    is_intact = found == _render(entries).encode() and not any(_is_outside(PurePosixPath(name)) for name in entries)
    if not is_intact:
        raise UserError(f"{path}: damaged; copy the folder again")
    return entries


def check_folder(folder: Path, *, only: Container[str] | None = None, thorough: bool = False) -> None:
    """Compares the files of a folder with its manifest, and stops at the first that has changed.

    Args:
        folder: The folder.
        only: Names of the files to compare; None for all of the manifest.
        thorough: Compare SHA-256, too, as `changes` says.

    Raises:
        UserError: A file is missing or has changed, or the manifest is missing or damaged.
    """
    for _, problem in changes(folder, only=only, thorough=thorough):
        raise UserError(f"{problem}; copy the folder again")


def changes(folder: Path, *, only: Container[str] | None = None, thorough: bool = False) -> Iterator[tuple[str, str]]:
    """Yields the name of each file of a folder that is missing or differs from the manifest, and a line about it.

    Sizes and CRC-32 are compared, which finds damage; if `thorough`, SHA-256, too, which also finds changes that were
    made to look like none.

    Raises:
        UserError: The manifest is missing or damaged.
    """
    for name, expected in read_manifest(folder).items():
        if only is not None and name not in only:
            continue
        try:
            found = _measure(folder / name, sha256=thorough)
        except UserError as error:
            yield name, str(error)
            continue
        if found != (expected if thorough else expected._replace(sha256="")):
            yield name, f"{folder / name}: has changed since it was written, or is damaged"


def _is_outside(path: PurePosixPath) -> bool:
    return path.is_absolute() or ".." in path.parts


def _measure(path: Path, *, sha256: bool = True) -> Entry:
    """Returns the size and checksums of a file, without `sha256` an empty one in its place."""
    crc32 = 0
    size = 0
    digest = hashlib.sha256()
    with reading(path), path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            crc32 = zlib.crc32(chunk, crc32)
            size += len(chunk)
            if sha256:
                digest.update(chunk)
    return Entry(f"{crc32:08x}", digest.hexdigest() if sha256 else "", size)


def _render(entries: dict[str, Entry]) -> str:
    lines = [f"{crc32} {sha256} {size} {name}\n" for name, (crc32, sha256, size) in sorted(entries.items())]
    text = "".join([f"{_TITLE}\n", *lines])
    return f"{text}{hashlib.sha256(text.encode()).hexdigest()}\n"


def save_sealed(path: Path, text: str) -> None:
    """Writes lines of text and their checksum."""
    save_text(path, f"{text}{_seal(text)}")


def load_sealed(path: Path) -> str:
    """Returns a text without its checksum.

    Raises:
        UserError: It is missing, or has changed since it was written.
    """
    found = load_text(path)
    text, _, _ = found.rpartition(_SEAL)
    if found != f"{text}{_seal(text)}":
        raise UserError(f"{path}: has changed since it was written, or is damaged; put the old file back")
    return text


def _seal(text: str) -> str:
    return f"{_SEAL}{hashlib.sha256(text.encode()).hexdigest()}\n"


def save_sealed_json(path: str | Path, data: Mapping[str, Any]) -> None:
    """Writes named entries as JSON, with a checksum as one more entry.

    Raises:
        ValueError: A number is not finite.
    """
    save_json(path, {**data, CHECKSUM: _entries_checksum(data)})


def load_sealed_json(path: str | Path, *, max_bytes: int = MAX_TEXT, entries: Iterable[str]) -> dict[str, Any]:
    """Returns the entries of a JSON file without their checksum, which files of older versions do not have.

    Args:
        path: The file.
        max_bytes: The largest file that is read.
        entries: Names that the entries of a file without a checksum may have: the name of the checksum may be damaged.

    Raises:
        UserError: It is missing, is not a JSON object, or has changed since it was written.
    """
    data = load_json(Path(path), max_bytes=max_bytes)
    if not isinstance(data, dict):
        raise UserError(f"{path}: is not a report; it has no named entries (a JSON object)")
    checksum = data.pop(CHECKSUM, None)
    if checksum is not None and checksum != _entries_checksum(data):
        raise UserError(f"{path}: has changed since it was written, or is damaged; its checksum does not fit")
    unknown = () if checksum is not None else sorted(data.keys() - set(entries))
    if unknown:
        raise UserError(f"{path}: is not a report, or damaged; it has an unknown entry {unknown[0]!r} and no checksum")
    return data


def _entries_checksum(data: Mapping[str, Any]) -> str:
    """Returns the checksum of values, which does not depend on spaces and the order of entries."""
    # Twice, so that keys are the texts that they are in the file.
    plain = json.loads(json.dumps(data, allow_nan=False))
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()
