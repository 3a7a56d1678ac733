"""Captions as the evaluator reads them: numbers of words, classes of words, and vectors for the words."""

import logging
import re
import zlib
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from tokenize import TokenError
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from t2m_jax.errors import UserError
from t2m_jax.text.parts_of_speech import OTHER, part_of_speech

logger = logging.getLogger(__name__)

START, END, UNKNOWN = "sos", "eos", "unk"
MAX_WORDS = 20
"""Words of a caption that are read; what stands behind is cut."""
MIN_COUNT = 3
"""How often training captions must use a word, unless said otherwise, for an own vocabulary to have it."""
TEXT_LENGTH = MAX_WORDS + 2
"""Words in an array: start, caption, end."""

_DAMAGED = (OSError, ValueError, EOFError, TokenError, SyntaxError, TypeError, OverflowError, MemoryError)
"""What NumPy raises on damaged files: it believes their headers, and reads those as Python."""


class WordIds(NamedTuple):
    """One caption, or with an axis in front many."""

    words: Int[Array | np.ndarray, "*batch S"]
    parts_of_speech: Int[Array | np.ndarray, "*batch S"]
    length: Int[Array | np.ndarray, "*batch"]
    """Words, start and end counted, padding not."""


class Vocabulary:
    """The words an evaluator knows, each with its number; `sos`, `eos` and `unk` are among them."""

    def __init__(self, words: Sequence[str]):
        """Takes the words in the order of their numbers.

        Raises:
            UserError: a word stands twice, or one of the three marks is missing.
        """
        self.words = tuple(words)
        self._number = {word: number for number, word in enumerate(self.words)}
        if len(self._number) < len(self.words):
            twice = Counter(self.words).most_common(1)[0][0]
            raise UserError(f"vocabulary: '{twice}' stands in it twice; keep one")
        for mark in (START, END, UNKNOWN):
            if mark not in self._number:
                raise UserError(f"vocabulary: '{mark}' is missing; every vocabulary has {START}, {END} and {UNKNOWN}")

    def __len__(self) -> int:
        return len(self.words)

    def __contains__(self, word: str) -> bool:
        return word in self._number

    def vectorize(self, tokens: Sequence[str]) -> WordIds:
        """Returns a caption of `word/TAG` tokens as numbers, padded to the length of all captions.

        Words are matched as they are spelled. One that is not known becomes `unk` of class OTHER, whatever its tag; a
        known one without a proper tag is of class OTHER unless it is special. Behind the 20th word all are cut, and a
        caption may have none.
        """
        kept = [_word_and_tag(token) for token in tokens[:MAX_WORDS]]
        sentence = [(START, ""), *kept, (END, "")]
        padded = sentence + [(UNKNOWN, "")] * (TEXT_LENGTH - len(sentence))
        words, classes = np.full(TEXT_LENGTH, self._number[UNKNOWN], np.int32), np.full(TEXT_LENGTH, OTHER, np.int32)
        for position, (word, tag) in enumerate(padded):
            if word in self._number:
                words[position], classes[position] = self._number[word], part_of_speech(word, tag)
        return WordIds(words, classes, np.array(len(sentence), np.int32))

    def vectorize_all(self, captions: Iterable[Sequence[str]]) -> WordIds:
        """Returns captions of tokens as rows of numbers.

        Raises:
            ValueError: there are none.
        """
        rows = [self.vectorize(tokens) for tokens in captions]
        return WordIds(*(np.stack(column) for column in zip(*rows, strict=True)))


def _word_and_tag(token: str) -> tuple[str, str]:
    """Returns both halves of `word/TAG`; a token of another form has no tag that is one."""
    word, _, tag = token.partition("/")
    return word, tag


def tokens_from_text(text: str) -> tuple[str, ...]:
    """Returns the words of a caption in lower case, without tags: what stands in for tokens where a file has none."""
    return tuple(re.findall(r"[^\W\d_]+", text.lower()))


def vocabulary_from_captions(captions: Iterable[Sequence[str]], *, min_count: int) -> Vocabulary:
    """Returns the words that captions (of tokens) use at least `min_count` times, behind `sos`, `eos` and `unk`.

    Frequent words come first, equally frequent ones in the order of the alphabet.
    """
    counts = Counter(_word_and_tag(token)[0] for tokens in captions for token in tokens)
    known = [word for word, count in counts.items() if count >= min_count and word.isalpha()]
    ordered = sorted(known, key=lambda word: (-counts[word], word))
    return Vocabulary((START, END, UNKNOWN, *(word for word in ordered if word not in (START, END, UNKNOWN))))


def load_vocabulary(path: Path) -> Vocabulary:
    """Returns the vocabulary of a text file with one word a line; the line is the word's number.

    Raises:
        UserError: the file is missing, is no UTF-8, has an empty line, or lacks one of the three marks.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: is not UTF-8 text; a vocabulary has one word a line") from error
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); a vocabulary has one word a line") from error
    for number, line in enumerate(lines, start=1):
        if not line or line != line.strip():
            raise UserError(f"{path}:{number}: no word, or blanks around it; a vocabulary has one word a line")
    try:
        return Vocabulary(lines)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None


def save_vocabulary(path: Path, vocabulary: Vocabulary) -> None:
    """Writes one word a line."""
    path.write_text("".join(f"{word}\n" for word in vocabulary.words), encoding="utf-8", newline="\n")


def load_word_vectors(path: Path, words: Sequence[str]) -> Float[np.ndarray, "W X"]:
    """Returns one vector a word, from a table (`.npy`, a row a word) or a GloVe file (`word v1 v2 ...` a line).

    A word that the GloVe file has not gets numbers drawn by its spelling, as wide as those of the words it has; how
    many there are is logged.

    Raises:
        UserError: the file cannot be read, is damaged, has another number of rows, or knows none of the words.
    """
    if path.suffix == ".npy":
        table = load_vector_table(path)
        if len(table) != len(words):
            raise UserError(f"{path}: {len(table)} vectors for {len(words)} words; give the table of this vocabulary")
        return table
    found = _glove_vectors(path, frozenset(words))
    if not found:
        raise UserError(f"{path}: has none of the {len(words)} words; give a GloVe text file, 'word v1 v2 ...' a line")
    spread = float(np.std(list(found.values())))
    width = len(next(iter(found.values())))
    missing = [word for word in words if word not in found]
    if missing:
        logger.warning("%s: %d of %d words are not in it, such as '%s'", path, len(missing), len(words), missing[0])
    for word in missing:
        drawn = np.random.default_rng(zlib.crc32(word.encode())).normal(size=width)
        found[word] = (spread * drawn).astype(np.float32)
    return np.stack([found[word] for word in words])


def load_vector_table(path: Path) -> Float[np.ndarray, "W X"]:
    """Returns a table of word vectors from a `.npy` file, one row a word.

    Raises:
        UserError: the file cannot be read, or is no table of finite numbers.
    """
    try:
        table = np.load(path)
    except _DAMAGED as error:
        raise UserError(f"{path}: cannot be read as a NumPy array of word vectors") from error
    if not isinstance(table, np.ndarray) or table.ndim != 2 or table.dtype.kind != "f" or not table.size:
        raise UserError(f"{path}: expected a table of floating-point numbers, one row a word")
    if not np.isfinite(table).all():
        raise UserError(f"{path}: has values that are not finite")
    return table.astype(np.float32)


def _glove_vectors(path: Path, words: frozenset[str]) -> dict[str, Float[np.ndarray, " X"]]:
    """Returns the vectors of those of some words that a GloVe file has."""
    found: dict[str, np.ndarray] = {}
    width = 0
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, start=1):
                word, _, rest = line.rstrip("\n").partition(" ")
                if word not in words or word in found:
                    continue
                vector = np.array(rest.split(), np.float32)
                width = width or len(vector)
                if len(vector) != width or not width or not np.isfinite(vector).all():
                    raise UserError(f"{path}:{number}: not a word and {width or 'some'} finite numbers")
                found[word] = vector
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: is not UTF-8 text; give a GloVe text file") from error
    except ValueError as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{path}:{number}: not a word and numbers behind it; give a GloVe text file") from error
    return found
