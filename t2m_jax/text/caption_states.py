"""Token states of captions: computed once by a sentence encoder that is not trained, and kept on disk.

A network that is trained on them reads many captions again and again, while the encoder reads each caption once.
"""

import hashlib
import itertools
import json
import logging
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.errors import UserError
from t2m_jax.files.arrays import write_header
from t2m_jax.files.manifest import check_folder, write_manifest
from t2m_jax.files.reading import load_array, load_json
from t2m_jax.files.writing import atomic_folder, save_text

logger = logging.getLogger(__name__)

STATES = "states.npy"
CAPTIONS = "captions.json"
MAX_CAPTIONS_FILE = 2**30
WAIT_SECONDS = 6 * 3600.0
"""How long a process waits for another that computes the same states."""
UNIT = 8
"""Batches have room for a multiple of so many tokens, so that data sets with similar captions share programs."""

ReadStates = Callable[[Sequence[str]], Iterator[tuple[str, Float[np.ndarray, "S C"]]]]
"""From captions to each of them, in any order, with the states of its tokens."""


class CaptionStates(NamedTuple):
    """A batch of captions as token states. States where the mask is False are zero."""

    states: Float[Array | np.ndarray, "B S C"]
    mask: Bool[Array | np.ndarray, "B S"]
    numbers: Int[Array | np.ndarray, " B"]
    """Equal captions have equal numbers."""


class StateTable(NamedTuple):
    """The token states of all captions end to end: those of text t are `states[starts[t] : starts[t] + lengths[t]]`."""

    states: Float[Array | np.ndarray, "N C"]
    """In 16 bits; a view of a file until training puts it on its devices. On a CPU it stays there."""
    starts: Int[Array | np.ndarray, " T"]
    lengths: Int[Array | np.ndarray, " T"]
    numbers: Int[Array | np.ndarray, " M"]
    """The text of each caption: many captions of a data set are equal."""
    places: Int[Array | np.ndarray, " S"]
    """The places of tokens in batches: 0 to S - 1."""

    def batch(self, captions: Int[Array, " B"]) -> CaptionStates:
        """Returns the states of some captions."""
        texts = self.numbers[captions]
        mask = self.places[None] < self.lengths[texts][:, None]
        rows = jnp.where(mask, self.starts[texts][:, None] + self.places[None], 0)
        states = jnp.where(mask[:, :, None], self.states[rows].astype(jnp.float32), 0.0)
        return CaptionStates(states, mask, texts)


class StoredStates(NamedTuple):
    """A folder of states: those of its texts end to end."""

    states: Float[np.ndarray, "N C"]
    texts: list[str]
    lengths: list[int]

    def spans(self) -> dict[str, tuple[int, int]]:
        """Returns the first row of each text, and the row after its last."""
        ends = itertools.accumulate(self.lengths, initial=0)
        return dict(zip(self.texts, itertools.pairwise(ends), strict=True))


def open_state_table(
    places: Sequence[Path], encoder: str, captions: Sequence[str], read: ReadStates, *, max_length: int
) -> StateTable:
    """Returns the states of captions, from one of the folders `places`, where they are put if they are new.

    Args:
        places: Folders of states; the first that can be written is used.
        encoder: Fingerprint of the sentence encoder.
        captions: May have equal ones.
        read: The sentence encoder.
        max_length: Tokens of a caption that are used.

    Raises:
        UserError: The states cannot be written anywhere.
    """
    stored = _find_or_make(places, encoder, sorted(set(captions)), read)
    return table_from_states(stored, captions, max_length=max_length)


def table_from_states(stored: StoredStates, captions: Sequence[str], *, max_length: int) -> StateTable:
    """Returns the table of captions whose texts are stored; of a caption, `max_length` tokens are used."""
    number = {text: place for place, text in enumerate(stored.texts)}
    lengths = np.array(stored.lengths, np.int32)
    starts = np.cumsum(lengths, dtype=np.int32) - lengths
    longest = min(-(-int(lengths.max()) // UNIT) * UNIT, max_length)
    numbers = np.array([number[caption] for caption in captions], np.int32)
    return StateTable(stored.states, starts, lengths, numbers, np.arange(longest, dtype=np.int32))


def _find_or_make(places: Sequence[Path], encoder: str, texts: list[str], read: ReadStates) -> StoredStates:
    digest = hashlib.blake2b(json.dumps(texts).encode(), digest_size=8).hexdigest()
    folders = [place / f"{encoder[:16]}-{digest}" for place in places]
    for folder in folders:
        if folder.exists():
            try:
                return _load(folder)
            except UserError as error:
                logger.warning("%s; the states of captions are computed again", error)
    problems = []
    for folder in folders:
        try:
            _make(folder, texts, read, others=[other for place in places for other in place.glob(f"{encoder[:16]}-*")])
        except UserError as error:
            problems.append(str(error))
        # Also after a failure: another process may have finished the folder while this one waited.
        if folder.exists():
            return _load(folder)
    raise UserError(f"{problems[0]} (for the states of captions; nor at {places[-1]})")


def _load(folder: Path) -> StoredStates:
    """Returns the states in a folder.

    Raises:
        UserError: A file is missing or damaged.
    """
    check_folder(folder)
    data = load_json(folder / CAPTIONS, max_bytes=MAX_CAPTIONS_FILE)
    return StoredStates(load_array(folder / STATES, mmap=True), data["texts"], data["lengths"])


def _make(folder: Path, texts: list[str], read: ReadStates, *, others: Iterable[Path]) -> None:
    """Writes the states of texts; those that another folder has are copied.

    Raises:
        UserError: The folder cannot be written, or another process has finished it.
    """
    # It is damaged. Processes that have mapped its states keep them.
    shutil.rmtree(folder, ignore_errors=True)
    with atomic_folder(folder, seconds=WAIT_SECONDS) as partial, (partial / STATES).open("w+b") as file:
        lengths: dict[str, int] = {}
        for text, states in _states_of(texts, read, others):
            if not lengths:
                write_header(file, (0, states.shape[1]), np.float16)
            file.write(np.asarray(states, np.float16).tobytes())
            lengths[text] = len(states)
        write_header(file, (sum(lengths.values()), states.shape[1]), np.float16)
        file.flush()  # the manifest reads the file by its name
        save_text(partial / CAPTIONS, json.dumps({"texts": list(lengths), "lengths": list(lengths.values())}))
        write_manifest(partial)


def _states_of(
    texts: list[str], read: ReadStates, others: Iterable[Path]
) -> Iterator[tuple[str, Float[np.ndarray, "S C"]]]:
    """Yields texts with their states, first those that other folders have."""
    missing = dict.fromkeys(texts)
    for other in others:
        try:
            stored = _load(other)
        except UserError:  # damaged, or being written
            continue
        for text, (first, end) in stored.spans().items():
            if text in missing:
                del missing[text]
                yield text, stored.states[first:end]
    yield from read(list(missing))


def captions_at(captions: Any, rows: Int[Array, " B"]) -> Any:
    """Returns some captions of a table: token states, or rows of arrays."""
    if isinstance(captions, StateTable):
        return captions.batch(rows)
    return jax.tree.map(lambda table: table[rows], captions)
