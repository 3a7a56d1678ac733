"""All clips of a data-set folder in one array that is mapped into memory.

The cache is a folder. `frames.npy` has the frames of all usable clips end to end (float32, training clips first).
`index.json` has the clips' names, lengths and captions, the reasons for clips that are left out, and checksums. The
cache is made when the data set is first read, and again when names, sizes or times of its files have changed. `t2m
check` also compares the contents of the files. The cache is in `.t2m-cache` next to the data or, if that folder is not
writable, in the user's cache folder.
"""

import contextlib
import hashlib
import itertools
import json
import logging
import os
import shutil
import sys
import zlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import platformdirs
from jaxtyping import Float
from tqdm import tqdm

from t2m_jax.data.files import FEATURES, SPLITS, TEXTS, clip_or_reason, read_names
from t2m_jax.data.texts import Caption
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import write_header
from t2m_jax.files.reading import load_array, load_json, reading
from t2m_jax.files.writing import atomic_folder, save_text

logger = logging.getLogger(__name__)

CACHE_FOLDER = ".t2m-cache"
CACHE_NAME = "clips"
STATES_NAME = "caption_states"
CODES_NAME = "codes"
FRAMES = "frames.npy"
INDEX = "index.json"
BLOCK = 4 * 2**20
"""Bytes per checksum of the frames."""
WAIT_SECONDS = 30.0
"""How long a process waits for another one that writes the same cache. Then it makes its own in the user's cache
folder, because the other one may hang."""
MAX_INDEX = 2**31
"""The largest index in bytes. It has the captions of all clips, so it grows with the data."""


class CachedClips(NamedTuple):
    """The clips of a folder. `frames` is mapped and read-only."""

    frames: Float[np.ndarray, "F D"]
    spans: Mapping[str, tuple[int, int]]
    """Clip name -> first row, end row (exclusive)."""
    lines: Mapping[str, list[tuple[str, str, float, float]]]
    """Clip name -> its valid captions as text, tokens, start and end."""
    left_out: Mapping[str, str]
    """Clip name -> why it cannot be used."""
    broken_captions: Mapping[str, int]
    """Clip name -> number of caption lines that cannot be read, for clips that have such lines."""
    blocks: list[int]
    """Checksums of the blocks of `frames`."""
    files: Mapping[str, int]
    """Clip name -> checksum of its files."""

    @property
    def fingerprint(self) -> str:
        """Identifies the contents: names, frames and captions of all clips, wherever the folder is."""
        tables = (self.spans, self.lines, self.left_out, self.broken_captions)
        return _hash(json.dumps([[list(table.items()) for table in tables], self.blocks]))

    def features(self, name: str) -> Float[np.ndarray, "T D"]:
        """Returns the rows of a clip, a view of `frames`."""
        first, end = self.spans[name]
        return self.frames[first:end]

    def captions(self, name: str) -> tuple[Caption, ...]:
        """Returns the captions of a clip. Words are interned: most of them are in thousands of captions."""
        return tuple(
            Caption(text, tuple(sys.intern(token) for token in tokens.split()), start, end)
            for text, tokens, start, end in self.lines[name]
        )


class _UnusableError(Exception):
    """The reason why a cache cannot be used."""


class _StaleError(_UnusableError):
    """The cache is complete, but the data set has changed since it was made."""


class Sources(NamedTuple):
    """The clip files of a folder at this moment."""

    names: frozenset[str]
    """Names of the clips that have at least one file."""
    fingerprint: str
    """Hash of the names, sizes and times of all files, and of the expected feature width."""


def scan_sources(folder: Path, *, feature_dim: int) -> Sources:
    """Returns the clip files of a folder without opening them."""
    names = set()
    lines = []
    for part, suffix in ((FEATURES, ".npy"), (TEXTS, ".txt")):
        if not (folder / part).is_dir():
            continue
        with os.scandir(folder / part) as entries:
            for entry in entries:
                # Hidden files are those that macOS writes beside others, such as `._a.npy`.
                if entry.name.endswith(suffix) and not entry.name.startswith("."):
                    try:
                        status = entry.stat()
                    except OSError:  # a link to nothing, of which reading the clip says so
                        status = entry.stat(follow_symlinks=False)
                    names.add(entry.name.removesuffix(suffix))
                    lines.append(f"{part}/{entry.name} {status.st_size} {status.st_mtime_ns}")
    # Sorted, because the order of a folder's entries depends on the file system. Another width leaves out other clips.
    return Sources(frozenset(names), _hash("\n".join([f"width {feature_dim}", *sorted(lines)])))


def _hash(text: str) -> str:
    """Returns a short hash of a text; file names may have bytes that are not Unicode."""
    return hashlib.blake2b(text.encode(errors="surrogateescape"), digest_size=16).hexdigest()


def cache_places(folder: Path, name: str = CACHE_NAME) -> tuple[Path, Path]:
    """Returns the two possible places of a folder's cache: next to the data, and in the user's cache folder.

    Those of its captions' token states (`t2m_jax.text.caption_states`) and of its codes (`t2m_jax.train.code_cache`)
    have the names `STATES_NAME` and `CODES_NAME`.
    """
    user_folder = Path(platformdirs.user_cache_dir("t2m_jax"))
    return folder / CACHE_FOLDER / name, user_folder / name / _hash(str(folder.resolve()))


def open_clips(folder: Path, *, feature_dim: int, names: Collection[str] = ()) -> CachedClips:
    """Returns the clips of a folder from its cache. A cache that is missing, stale or damaged is made first.

    Args:
        folder: The data set.
        feature_dim: Width of its features.
        names: Clips whose frames will be read. They are compared with their checksums.

    Raises:
        UserError: The cache cannot be written anywhere.
    """
    sources = scan_sources(folder, feature_dim=feature_dim)
    places = cache_places(folder)
    for place in places:
        if place.exists():
            try:
                return load_cache(place, sources, names)
            except _UnusableError as error:
                logger.warning("%s: %s; the cache is rebuilt", place, error)
    problems = []
    for place in places:
        try:
            _build(place, folder, sources, feature_dim=feature_dim)
        except UserError as error:
            problems.append(str(error))
        # Also after a failure: another process may have finished the cache while this one waited.
        try:
            return load_cache(place, sources, names)
        except _UnusableError as error:
            problems.append(f"{place}: {error}")
    raise UserError(
        f"{folder}: no room for the cache of its clips: it {problems[0].rpartition(': ')[2]}; nor at {places[1]}"
    )


def load_cache(path: Path, sources: Sources, names: Collection[str] | None = ()) -> CachedClips:
    """Returns the clips in a cache.

    Args:
        path: The cache.
        sources: The files that it must have been made from.
        names: Clips whose frames are compared with their checksums; None for all. A gigabyte takes 0.2 s.

    Raises:
        _UnusableError: The cache is damaged, was made from other files, or cannot be read.
    """
    try:
        index = load_json(path / INDEX, max_bytes=MAX_INDEX)
        # First of all, because nothing in a damaged index can be believed.
        if index.pop("checksum") != _checksum(index):
            raise _UnusableError("its index is damaged")
        if "files" not in index:
            raise _StaleError("made by an older version")
        if index["fingerprint"] != sources.fingerprint:
            raise _StaleError("the data set has changed since")
        clips = _clips_from_index(index, np.asarray(load_array(path / FRAMES, mmap=True)))
        with (path / FRAMES).open("rb") as file:
            # Not the whole file, which may be larger than the memory; `t2m data check` reads it all.
            for block in _blocks_of(clips, names, file.seek(0, os.SEEK_END)):
                if _block_checksum(file, block) != clips.blocks[block]:
                    raise _UnusableError(f"its frames are damaged at byte {block * BLOCK} or later")
        return clips
    except OSError as error:
        raise _UnusableError(f"cannot be read ({error.strerror})") from error
    # A damaged file can contain anything, and whatever is wrong, the cache is made again.
    except (ValueError, AttributeError, LookupError, TypeError, RecursionError) as error:
        raise _UnusableError("damaged") from error


def damage(path: Path, folder: Path, sources: Sources) -> str:
    """Returns a description of the damage in the cache of a folder, or "" if it is intact.

    All is read: a file that was changed without another size or time is damage, too. A stale cache is never used, so
    damage in it does no harm and is not reported.
    """
    try:
        for name, checksum in load_cache(path, sources, None).files.items():
            if checksum != _files_checksum(folder, name):
                return f"the files of clip {name} have changed since, with their size and time kept"
    except _StaleError:
        return ""
    except _UnusableError as error:
        return str(error)
    return ""


def _checksum(index: Mapping[str, Any]) -> int:
    """Returns the checksum of an index."""
    return zlib.crc32(json.dumps(index).encode())


def _files_checksum(folder: Path, name: str) -> int:
    """Returns the checksum of the files of a clip."""
    checksum = 0
    for path in (folder / FEATURES / f"{name}.npy", folder / TEXTS / f"{name}.txt"):
        # A file that cannot be read is a clip that is left out, which says why.
        with contextlib.suppress(UserError), reading(path):
            checksum = zlib.crc32(path.read_bytes(), checksum)
    return checksum


def _block_checksum(file: BinaryIO, block: int) -> int:
    file.seek(block * BLOCK)
    return zlib.crc32(file.read(BLOCK))


def _blocks_of(clips: CachedClips, names: Collection[str] | None, size: int) -> list[int]:
    """Returns the blocks of a file of `size` bytes that contain its header or the frames of some clips (None: all)."""
    if names is None:
        return list(range(-(-size // BLOCK)))
    row = clips.frames.strides[0]
    header = size - clips.frames.nbytes
    spans = [clips.spans[name] for name in names if name in clips.spans]
    edges = ((header + first * row, header + end * row - 1) for first, end in spans)
    # The header is in block 0.
    return sorted({0}.union(*(range(first // BLOCK, last // BLOCK + 1) for first, last in edges)))


def _clips_from_index(index: dict[str, Any], frames: Float[np.ndarray, "F D"]) -> CachedClips:
    """Returns the clips in a cache after checking that the index has the types that `_build` writes."""
    sound = frames.ndim == 2 and frames.dtype == np.float32 and frames.flags.c_contiguous
    for name, length, lines in index["clips"]:
        # Exact types: for `isinstance`, JSON's `true` is an `int`.
        sound &= type(name) is str and type(length) is int and length > 0
        sound &= all([type(field) for field in line] == [str, str, float, float] for line in lines)
    left_out, broken, files = (index[table] for table in ("left_out", "broken_captions", "files"))
    for table, kind in ((left_out, str), (broken, int), (files, int)):
        sound &= isinstance(table, dict) and all(type(value) is kind for value in table.values())
    ends = list(itertools.accumulate((length for _, length, _ in index["clips"]), initial=0))
    if not sound or len(frames) != ends[-1]:
        raise _UnusableError("damaged")
    names = [name for name, _, _ in index["clips"]]
    lines = {name: clip_lines for name, _, clip_lines in index["clips"]}
    spans = dict(zip(names, itertools.pairwise(ends), strict=True))
    return CachedClips(frames, spans, lines, left_out, broken, index["blocks"], files)


def _build(path: Path, folder: Path, sources: Sources, *, feature_dim: int) -> None:
    """Writes the cache of a folder, or waits until another process that writes it has finished.

    Raises:
        UserError: The cache cannot be written here, the other process has finished it, or it takes longer than
            `WAIT_SECONDS`.
    """
    # Open files survive this: processes that have mapped the old cache keep it.
    shutil.rmtree(path, ignore_errors=True)
    with atomic_folder(path, seconds=WAIT_SECONDS) as partial, (partial / FRAMES).open("w+b") as file:
        index = _write_clips(file, folder, sources.names, feature_dim=feature_dim)
        files = {name: _files_checksum(folder, name) for name in sorted(sources.names)}
        index |= {"fingerprint": sources.fingerprint, "files": files}
        count = -(-file.seek(0, os.SEEK_END) // BLOCK)
        index |= {"blocks": [_block_checksum(file, block) for block in range(count)]}
        save_text(partial / INDEX, json.dumps(index | {"checksum": _checksum(index)}))


def _write_clips(file: BinaryIO, folder: Path, names: frozenset[str], *, feature_dim: int) -> dict[str, Any]:
    """Writes the frames of all usable clips as a `.npy` file and returns the part of the index that describes them."""
    listed = [read_names(path) for split in SPLITS if (path := folder / f"{split}.txt").exists()]
    # Training clips come first, so that a training maps one part of the file.
    order = [name for name in dict.fromkeys(itertools.chain(*listed, sorted(names))) if name in names]
    clips: list[tuple[str, int, list[tuple[str, str, float, float]]]] = []
    left_out: dict[str, str] = {}
    broken_captions: dict[str, int] = {}

    write_header(file, (0, feature_dim), np.float32)
    for name in tqdm(order, desc="caching clips", unit="clip", disable=None):
        clip = clip_or_reason(folder, name, feature_dim=feature_dim)
        if isinstance(clip, str):
            left_out[name] = clip
            continue
        features, (captions, problems) = clip
        file.write(features.tobytes())
        lines = [(caption.text, " ".join(caption.tokens), caption.start, caption.end) for caption in captions]
        clips.append((name, len(features), lines))
        if problems:
            broken_captions[name] = len(problems)
    write_header(file, (sum(length for _, length, _ in clips), feature_dim), np.float32)
    return {"clips": clips, "left_out": left_out, "broken_captions": broken_captions}
