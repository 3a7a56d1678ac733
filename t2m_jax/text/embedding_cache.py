"""Text embeddings kept on disk, so that a model embeds each caption once."""

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
"""How long to wait for another process that is writing."""
CAPTIONS_A_QUERY = 500
"""SQLite takes at least 999 values at a time."""

_TABLE = """CREATE TABLE IF NOT EXISTS embeddings (
    fingerprint TEXT NOT NULL, caption TEXT NOT NULL, embedding BLOB NOT NULL, digest BLOB NOT NULL,
    PRIMARY KEY (fingerprint, caption))"""

_SELECT = "SELECT caption, embedding, digest FROM embeddings WHERE fingerprint = ? AND caption IN"

_FAILURES = (sqlite3.Error, OSError, UnicodeDecodeError)
"""What use of a file can raise; the last where SQLite's message quotes the damage."""

_OUT_OF_REACH = {
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN,
}
"""SQLite's codes for a file that may be sound but cannot be used now; all others mean that it is damaged."""


class EmbeddingCache:
    """Embeddings by caption and model, in one SQLite file that several processes may share.

    It never stands in the way: a file that cannot be used is done without, a damaged one is set aside and begun anew
    (both with a warning), and every row carries a digest, so a damaged embedding is never handed out.
    """

    def __init__(self, path: Path | None = None):
        """Names the file, by default one in the user's cache folder; nothing is opened yet."""
        self.path = path or Path(platformdirs.user_cache_dir("t2m_jax")) / CACHE_FILE

    def load(self, fingerprint: str, captions: Sequence[str]) -> dict[str, Float[np.ndarray, " E"]]:
        """Returns those embeddings of `captions` that the model `fingerprint` has left here."""
        rows: list[tuple] = []
        try:
            with self._open() as connection:
                for first in range(0, len(captions), CAPTIONS_A_QUERY):
                    chunk = list(captions[first : first + CAPTIONS_A_QUERY])
                    marks = ", ".join("?" * len(chunk))
                    rows += connection.execute(f"{_SELECT} ({marks})", [fingerprint, *chunk]).fetchall()
        except _FAILURES as error:
            self._do_without(error)
            return {}
        sound = {
            caption: np.frombuffer(blob, "<f4").astype(np.float32)
            for caption, blob, digest in rows
            if isinstance(blob, bytes) and digest == _digest(fingerprint, caption, blob)
        }
        if len(sound) < len({caption for caption, _, _ in rows}):
            logger.warning("%s: some embeddings are damaged; they are made anew", self.path)
        return sound

    def save(self, fingerprint: str, embeddings: Mapping[str, Float[np.ndarray, " E"]]) -> None:
        """Keeps embeddings of the model `fingerprint` by their caption, all of them or none."""
        rows = []
        for caption, embedding in embeddings.items():
            blob = np.asarray(embedding, "<f4").tobytes()
            rows.append((fingerprint, caption, blob, _digest(fingerprint, caption, blob)))
        try:
            with self._open() as connection:
                connection.executemany("INSERT OR REPLACE INTO embeddings VALUES (?, ?, ?, ?)", rows)
        except _FAILURES as error:
            self._do_without(error)

    @contextlib.contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        """Yields a connection whose changes count only if the block ends without an error."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.closing(sqlite3.connect(self.path, timeout=BUSY_SECONDS)) as connection, connection:
            # Waiting for the disk would cost more than what a power cut could spoil, which the digests show.
            connection.execute("PRAGMA synchronous = OFF")
            connection.execute(_TABLE)
            yield connection

    def _do_without(self, error: Exception) -> None:
        """Warns, and sets the file aside if it is damaged, so that the next use begins a new one."""
        code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT)
        if isinstance(error, OSError) or code & 0xFF in _OUT_OF_REACH:
            logger.warning("%s: cannot be used (%s); captions are embedded anew", self.path, error)
            return
        logger.warning("%s: damaged (%s); set aside as %s.damaged and begun anew", self.path, error, self.path.name)
        # A journal left beside it belongs to the damaged file and would be played back into the new one.
        for suffix in ("-journal", ""):
            with contextlib.suppress(OSError):
                os.replace(f"{self.path}{suffix}", f"{self.path}.damaged{suffix}")


def _digest(fingerprint: str, caption: str, blob: bytes) -> bytes:
    """Returns what tells a sound row from a damaged one."""
    return hashlib.blake2b(f"{fingerprint}\n{caption}\n".encode() + blob, digest_size=16).digest()
