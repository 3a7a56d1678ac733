"""The codes of motions on disk: to encode a data set takes minutes, and trainings of a tokenizer share its codes."""

import hashlib
import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float, Int

from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_archive
from t2m_jax.files.writing import atomic_file, writing

logger = logging.getLogger(__name__)

Codes = Int[np.ndarray, "_ R"]
MAX_CODES = 2**33
"""The largest file of codes in bytes, a hundred times those of HumanML3D."""


def code_key(tokenizer: str, cuts: str, motions: Iterable[Float[np.ndarray, "_ D"]]) -> str:
    """Returns what identifies the codes of motions, a digest.

    Args:
        tokenizer: Its fingerprint.
        cuts: Says which codes each motion has: all that decides where they start, and what is added to a motion.
        motions: Raw features.
    """
    # Another version may add other frames to a motion.
    digest = hashlib.blake2b(f"{version('t2m-jax')} {tokenizer} {cuts}".encode(), digest_size=16)
    for motion in motions:
        digest.update(f"{motion.shape} {motion.dtype}".encode())
        digest.update(motion.tobytes())
    return digest.hexdigest()


def cached_codes(places: Sequence[Path], key: str, encode: Callable[[], Iterable[Codes]]) -> Iterator[Codes]:
    """Returns the codes of each motion from one of the folders `places`, where they are put if they are new.

    Args:
        places: Folders of codes; the first that can be written is used.
        key: `code_key` of the motions.
        encode: Gives the codes of each motion.
    """
    # Several processes encode each batch together, so none may leave it out because only its disk has the codes.
    paths = [place / f"{key}.npz" for place in places if jax.process_count() == 1]
    for path in paths:
        if path.exists():
            try:
                return iter(_load(path))
            except UserError as error:
                logger.warning("%s; the motions are encoded again", error)
    codes = list(encode())
    # A split may have no motion of the right length.
    for path in paths if codes else []:
        try:
            _save(path, codes)
            break
        except UserError as error:
            logger.info("%s (for the codes of motions)", error)
    return iter(codes)


def _load(path: Path) -> list[Codes]:
    arrays = load_archive(path, max_unpacked=MAX_CODES)
    return np.split(arrays["codes"].astype(np.int32), np.cumsum(arrays["lengths"])[:-1])


def _save(path: Path, codes: Sequence[Codes]) -> None:
    with writing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    rows = np.concatenate(codes)
    # Two bytes are enough for codebooks of up to 65,536 codes.
    small = rows.astype(np.min_scalar_type(rows.max(initial=0)))
    with atomic_file(path) as partial:
        np.savez(partial, codes=small, lengths=np.array([len(some) for some in codes]))
