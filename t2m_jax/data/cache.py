"""All clips of a data-set folder in one file that is mapped into memory, made when the folder is first read.

The file holds the frames of all usable clips end to end (float32, those of the training split first), then an index
(JSON: names, lengths, captions, what was left out and why, a CRC-32 for each block of frames), then a footer that finds
and checks the index. Nothing in it is executed. It lies in `.t2m-cache` beside the data or, where that folder cannot be
written to, in the user's cache folder, and is made anew when the files it was made of have changed.
"""

import contextlib
import hashlib
import itertools
import json
import logging
import mmap
import os
import secrets
import struct
import sys
import time
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import platformdirs
from jaxtyping import Float
from tqdm import tqdm

from t2m_jax.data.files import FEATURES, SPLITS, TEXTS, clip_or_reason, read_names
from t2m_jax.data.texts import Caption
from t2m_jax.errors import UserError

logger = logging.getLogger(__name__)

CACHE_FOLDER, CACHE_FILE = ".t2m-cache", "clips.cache"
BLOCK = 4 * 2**20
"""Bytes a checksum stands for."""
BLOCKS_AT_OPENING = 50
"""Blocks that are compared with their checksum whenever the file is opened: 200 MB, a fraction of a second."""
ABANDONED_SECONDS = 3600.0
"""A half-made file that nobody has written to for so long is deleted."""

_MAGIC = b"t2mclip1"
_FOOTER = struct.Struct("<8sQQI")
"""Version, bytes of frames, bytes of index, CRC-32 of the index."""


class CachedClips(NamedTuple):
    """The clips of a folder; `frames` is the mapped file, read only."""

    frames: Float[np.ndarray, "F D"]
    spans: Mapping[str, tuple[int, int]]
    """Clip name -> first row, row behind the last."""
    lines: Mapping[str, list[tuple[str, str, float, float]]]
    """Clip name -> its sound captions as text, tokens, start and end."""
    left_out: Mapping[str, str]
    """Clip name -> why it cannot be used."""
    broken_captions: Mapping[str, int]
    """Clip name -> caption lines that cannot be read, where there are any."""

    def features(self, name: str) -> Float[np.ndarray, "T D"]:
        """Returns the rows of a clip, a view of `frames`."""
        first, last = self.spans[name]
        return self.frames[first:last]

    def captions(self, name: str) -> tuple[Caption, ...]:
        """Returns the captions of a clip; a word that stands in thousands of them is kept once."""
        return tuple(
            Caption(text, tuple(sys.intern(token) for token in tokens.split()), start, end)
            for text, tokens, start, end in self.lines[name]
        )


class _UnusableError(Exception):
    """Why a cache file is not to be used."""


class _StaleError(_UnusableError):
    """The file is whole but was made of other sources."""


class Sources(NamedTuple):
    """The clip files of a folder as they are now."""

    names: frozenset[str]
    """Of clips that have at least one file."""
    fingerprint: str
    """Of names, sizes and times of all files, and of the width that is expected of features."""


def scan_sources(folder: Path, *, feature_dim: int) -> Sources:
    """Returns what clip files a folder has; none of them is opened."""
    names, lines = set(), [f"width {feature_dim}"]
    for part, suffix in ((FEATURES, ".npy"), (TEXTS, ".txt")):
        if not (folder / part).is_dir():
            continue
        with os.scandir(folder / part) as entries:
            for entry in entries:
                if entry.name.endswith(suffix) and not entry.name.startswith("."):
                    status = entry.stat()
                    names.add(entry.name.removesuffix(suffix))
                    lines.append(f"{part}/{entry.name} {status.st_size} {status.st_mtime_ns}")
    text = "\n".join([lines[0], *sorted(lines[1:])])
    return Sources(frozenset(names), hashlib.blake2b(text.encode(errors="surrogateescape"), digest_size=16).hexdigest())


def cache_places(folder: Path) -> tuple[Path, Path]:
    """Returns where the cache of a folder may be: beside the data, and in the user's cache folder."""
    name = hashlib.blake2b(str(folder.resolve()).encode(errors="surrogateescape"), digest_size=16).hexdigest()
    own = Path(platformdirs.user_cache_dir("t2m_jax")) / "clips" / f"{name}.cache"
    return folder / CACHE_FOLDER / CACHE_FILE, own


def open_clips(folder: Path, *, feature_dim: int) -> CachedClips:
    """Returns the clips of a folder from its cache, which is made first if there is none that fits and is sound.

    Raises:
        UserError: there is no room for the cache anywhere.
    """
    sources = scan_sources(folder, feature_dim=feature_dim)
    places = cache_places(folder)
    for place in places:
        if place.exists():
            try:
                return load_cache(place, sources)
            except _UnusableError as error:
                logger.warning("%s: %s; the cache is made anew", place, error)
    failure: OSError | None = None
    for place in places:
        try:
            _build(place, folder, sources, feature_dim=feature_dim)
        except OSError as error:
            failure = error
            continue
        try:
            return load_cache(place, sources)
        except _UnusableError as error:
            raise UserError(f"{place}: {error} although it was just written; check the disk") from error
    reason = failure.strerror if failure else ""
    raise UserError(
        f"{folder}: no room for the cache of its clips, neither at {places[0]} nor at {places[1]} ({reason})"
    )


def load_cache(path: Path, sources: Sources, *, every_block: bool = False) -> CachedClips:
    """Returns the clips in a cache file; with `every_block` all of it is compared with its checksums, else a sample.

    Raises:
        _UnusableError: the file is not whole, was made of other sources, or cannot be read.
    """
    try:
        with path.open("rb") as file:
            index, num_bytes = _read_index(file)
            if index["fingerprint"] != sources.fingerprint:
                raise _StaleError("the data set has changed since")
            _check_blocks(file, index["checksums"], num_bytes, every_block=every_block)
            return _clips_from_index(index, file, num_bytes)
    except OSError as error:
        raise _UnusableError(f"cannot be read ({error.strerror})") from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise _UnusableError("its index is damaged") from error


def damage(path: Path, sources: Sources) -> str:
    """Returns what is wrong with the data in a cache file made of these sources, "" if nothing is.

    A cache that was made of other sources is not used any more, so nothing in it can do harm.
    """
    try:
        load_cache(path, sources, every_block=True)
    except _StaleError:
        return ""
    except _UnusableError as error:
        return str(error)
    return ""


def _read_index(file: BinaryIO) -> tuple[dict[str, Any], int]:
    """Returns the index of a cache file and the number of bytes of its frames."""
    size = file.seek(0, os.SEEK_END)
    if size < _FOOTER.size:
        raise _UnusableError("damaged, it is too short")
    file.seek(size - _FOOTER.size)
    magic, num_bytes, index_bytes, checksum = _FOOTER.unpack(file.read(_FOOTER.size))
    if magic != _MAGIC or num_bytes + index_bytes + _FOOTER.size != size:
        raise _UnusableError("damaged or of another version")
    file.seek(num_bytes)
    text = file.read(index_bytes)
    if zlib.crc32(text) != checksum:
        raise _UnusableError("its index is damaged")
    return json.loads(text), num_bytes


def _check_blocks(file: BinaryIO, checksums: list[int], num_bytes: int, *, every_block: bool) -> None:
    """Raises `_UnusableError` where frames differ from their checksum; some blocks are a sample from first to last."""
    count = -(-num_bytes // BLOCK)
    if len(checksums) != count:
        raise _UnusableError("its index is damaged")
    num_chosen = count if every_block else min(count, BLOCKS_AT_OPENING)
    for block in np.linspace(0, count - 1, num_chosen).astype(int).tolist():
        file.seek(block * BLOCK)
        if zlib.crc32(file.read(min(BLOCK, num_bytes - block * BLOCK))) != checksums[block]:
            raise _UnusableError(f"damaged at byte {block * BLOCK} or behind it")


def _check_types(index: dict[str, Any]) -> None:
    """Raises `_UnusableError` where an index holds something else than `_write` puts there."""
    line_types = [str, str, float, float]
    sound = type(index["width"]) is int and index["width"] > 0
    for name, length, lines in index["clips"]:
        sound &= type(name) is str and type(length) is int and length > 0
        sound &= all([type(field) for field in line] == line_types for line in lines)
    for table, kind in ((index["left_out"], str), (index["broken_captions"], int)):
        sound &= isinstance(table, dict) and all(type(value) is kind for value in table.values())
    if not sound:
        raise _UnusableError("its index is damaged")


def _clips_from_index(index: dict[str, Any], file: BinaryIO, num_bytes: int) -> CachedClips:
    """Returns the clips that a sound index describes."""
    _check_types(index)
    width, lengths = index["width"], [length for _, length, _ in index["clips"]]
    ends = list(itertools.accumulate(lengths))
    if num_bytes != sum(lengths) * width * 4:
        raise _UnusableError("its index is damaged")
    spans = {name: (end - length, end) for (name, length, _), end in zip(index["clips"], ends, strict=True)}
    lines = {name: clip_lines for name, _, clip_lines in index["clips"]}
    frames = np.zeros((0, width), np.float32)
    if num_bytes:
        mapped = mmap.mmap(file.fileno(), num_bytes, access=mmap.ACCESS_READ)
        frames = np.ndarray((ends[-1], width), np.float32, mapped)
    return CachedClips(frames, spans, lines, index["left_out"], index["broken_captions"])


def _build(path: Path, folder: Path, sources: Sources, *, feature_dim: int) -> None:
    """Writes the cache of a folder, so that it appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _sweep(path)
    partial = path.with_name(f"{path.name}.{secrets.token_hex(8)}.partial")
    try:
        with partial.open("xb") as file:
            _write(file, folder, sources, feature_dim=feature_dim)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def _sweep(path: Path) -> None:
    """Deletes what a process that was killed has left half-made."""
    for partial in path.parent.glob(f"{path.name}.*.partial"):
        with contextlib.suppress(FileNotFoundError):  # another process sweeps, too
            if time.time() - partial.stat().st_mtime > ABANDONED_SECONDS:
                partial.unlink()


def _write(file: BinaryIO, folder: Path, sources: Sources, *, feature_dim: int) -> None:
    """Writes frames, index and footer."""
    frames = _CheckedWriter(file)
    clips: list[tuple[str, int, list[tuple[str, str, float, float]]]] = []
    left_out: dict[str, str] = {}
    broken_captions: dict[str, int] = {}
    for name in tqdm(_in_order(folder, sources.names), desc="caching clips", unit="clip", disable=None):
        clip = clip_or_reason(folder, name, feature_dim=feature_dim)
        if isinstance(clip, str):
            left_out[name] = clip
            continue
        features, (captions, problems) = clip
        frames.write(np.ascontiguousarray(features).data.cast("B"))
        lines = [(caption.text, " ".join(caption.tokens), caption.start, caption.end) for caption in captions]
        clips.append((name, len(features), lines))
        if problems:
            broken_captions[name] = len(problems)
    index = {
        "fingerprint": sources.fingerprint,
        "width": feature_dim,
        "clips": clips,
        "left_out": left_out,
        "broken_captions": broken_captions,
        "checksums": frames.checksums(),
    }
    text = json.dumps(index).encode()
    file.write(text)
    file.write(_FOOTER.pack(_MAGIC, frames.num_bytes, len(text), zlib.crc32(text)))


def _in_order(folder: Path, names: frozenset[str]) -> list[str]:
    """Returns clip names in the order of the split lists, training first, then those in none of them."""
    listed: list[str] = []
    for split in SPLITS:
        if (folder / f"{split}.txt").exists():
            listed += read_names(folder / f"{split}.txt")
    return [name for name in dict.fromkeys([*listed, *sorted(names)]) if name in names]


class _CheckedWriter:
    """Appends to a file and takes a checksum of every block."""

    def __init__(self, file: BinaryIO):
        self.num_bytes = 0
        self._file = file
        self._checksums: list[int] = []

    def write(self, data: memoryview) -> None:
        """Appends bytes."""
        self._file.write(data)
        while data:
            used = self.num_bytes % BLOCK
            if used == 0:
                self._checksums.append(0)
            piece = data[: BLOCK - used]
            self._checksums[-1] = zlib.crc32(piece, self._checksums[-1])
            self.num_bytes += len(piece)
            data = data[len(piece) :]

    def checksums(self) -> list[int]:
        """Returns one checksum a block."""
        return self._checksums
