"""A cache of text embeddings on disk, so that a model embeds each caption only once."""

import contextlib
import hashlib
import logging
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import platformdirs
from jaxtyping import Float

logger = logging.getLogger(__name__)

CACHE_FILE = "text_embeddings.sqlite3"
BUSY_SECONDS = 60.0
"""How long to wait while another process writes."""
CAPTIONS_A_QUERY = 500
"""Below 999, the limit of values per query in old versions of SQLite."""

_TABLE = """CREATE TABLE IF NOT EXISTS embeddings (
    fingerprint TEXT NOT NULL, caption TEXT NOT NULL, embedding BLOB NOT NULL, digest BLOB NOT NULL,
    PRIMARY KEY (fingerprint, caption))"""

_SELECT = "SELECT caption, embedding, digest FROM embeddings WHERE fingerprint = ? AND caption IN"

_FAILURES = (sqlite3.Error, OSError, UnicodeDecodeError)
"""Errors of damaged or unusable files. The last one occurs if SQLite's message quotes damaged text."""

_UNUSABLE = {
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN,
}
"""SQLite's codes for a file that cannot be used now. All other codes mean that the file is damaged."""


class EmbeddingCache:
    """Embeddings by caption and model, in one SQLite file that several processes can share.

    Problems with the file are warnings, never errors. A file that cannot be used is ignored. A damaged file is renamed
    and a new one is started. Each row has a digest, so that a damaged embedding is never returned.
    """

    def __init__(self, path: Path | None = None):
        """Sets the path, by default a file in the user's cache folder. The file is opened when it is used."""
        self.path = path or Path(platformdirs.user_cache_dir("t2m_jax")) / CACHE_FILE

    def load(self, fingerprint: str, captions: Sequence[str]) -> dict[str, Float[np.ndarray, " E"]]:
        """Returns the embeddings of `captions` that were saved for the model `fingerprint`."""
        rows: list[tuple] = []
        try:
            with self._open() as connection:
                for first in range(0, len(captions), CAPTIONS_A_QUERY):
                    chunk = list(captions[first : first + CAPTIONS_A_QUERY])
                    marks = ", ".join("?" * len(chunk))
                    rows += connection.execute(f"{_SELECT} ({marks})", [fingerprint, *chunk]).fetchall()
        except _FAILURES as error:
            self._handle_failure(error)
            return {}
        intact = {
            caption: np.frombuffer(blob, "<f4").astype(np.float32)
            for caption, blob, digest in rows
            if isinstance(blob, bytes) and digest == _digest(fingerprint, caption, blob)
        }
        if len(intact) < len({caption for caption, _, _ in rows}):
            logger.warning("%s: some embeddings are damaged; they are computed again", self.path)
        return intact

    def save(self, fingerprint: str, embeddings: Mapping[str, Float[np.ndarray, " E"]]) -> None:
        """Saves embeddings of the model `fingerprint` by their caption: all of them or, after an error, none."""
        rows = []
        for caption, embedding in embeddings.items():
            # The same bytes on every machine that shares the file.
            blob = np.asarray(embedding, "<f4").tobytes()
            rows.append((fingerprint, caption, blob, _digest(fingerprint, caption, blob)))
        try:
            with self._open() as connection:
                connection.executemany("INSERT OR REPLACE INTO embeddings VALUES (?, ?, ?, ?)", rows)
        except _FAILURES as error:
            self._handle_failure(error)

    @contextlib.contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        """Yields a connection. The changes are committed only if the block ends without an error."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.closing(sqlite3.connect(self.path, timeout=BUSY_SECONDS)) as connection, connection:
            # Do not wait for the disk: the digests detect what a power failure damages, and a cache can be lost.
            connection.execute("PRAGMA synchronous = OFF")
            connection.execute(_TABLE)
            yield connection

    def _handle_failure(self, error: Exception) -> None:
        """Logs a warning and, if the file is damaged, renames it, so that the next use starts a new one."""
        # Errors of decoding have no code.
        code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT)
        # The low byte is the kind of error; the others are details.
        if isinstance(error, OSError) or code & 0xFF in _UNUSABLE:
            logger.warning("%s: cannot be used (%s); captions are embedded again", self.path, error)
            return
        logger.warning("%s: damaged (%s); renamed to *.damaged, and a new file is started", self.path, error)
        # SQLite would replay a journal of the damaged file into the new one, so it is renamed first.
        for suffix in ("-journal", ""):
            with contextlib.suppress(OSError):
                os.replace(f"{self.path}{suffix}", f"{self.path}.damaged{suffix}")


def _digest(fingerprint: str, caption: str, blob: bytes) -> bytes:
    """Returns a checksum of one row."""
    return hashlib.blake2b(f"{fingerprint}\n{caption}\n".encode() + blob, digest_size=16).digest()
