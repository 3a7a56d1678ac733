"""Captions as the evaluator reads them: word numbers, parts of speech and word vectors."""

import logging
import re
import zlib
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_array, load_text, reading
from t2m_jax.files.writing import save_text

logger = logging.getLogger(__name__)

START = "sos"
END = "eos"
UNKNOWN = "unk"
MAX_WORDS = 20
"""Words of a caption that are read; the rest is cut."""
MAX_VALUE = 1e6
"""Size of a number in a word vector from which on it must be a mistake; those of GloVe are below 10."""
MIN_COUNT = 3
"""Default number of uses in training captions that a word needs to be in the vocabulary."""
TEXT_LENGTH = MAX_WORDS + 2
"""Width of an array of words: start, caption, end."""

TAGS = ("VERB", "NOUN", "DET", "ADP", "NUM", "AUX", "PRON", "ADJ", "ADV")
"""Tags of caption files that have a class of their own."""
SPECIAL_WORDS = {
    "Loc_VIP": "left right clockwise counterclockwise anticlockwise forward back backward up down straight curve",
    "Body_VIP": "arm chin foot feet face hand mouth leg waist eye knee shoulder thigh",
    "Obj_VIP": "stair dumbbell chair window floor car ball handrail baseball basketball",
    "Act_VIP": """walk run swing pick bring kick put squat throw hop dance jump turn stumble stop sit lift lower raise
        wash stand kneel stroll rub bend balance flap jog shuffle lean rotate spin spread climb""",
    "Desc_VIP": "slowly carefully fast careful slow quickly happy angry sad happily angrily sadly",
}
"""Words that matter for motion (location, body, object, action, manner). Their class counts more than their tag."""
PARTS_OF_SPEECH = (*TAGS, *SPECIAL_WORDS, "OTHER")
"""The fifteen word classes of the evaluator (Guo et al. 2022), in the order of their numbers."""
OTHER = PARTS_OF_SPEECH.index("OTHER")
_CLASS_OF_WORD = {word: PARTS_OF_SPEECH.index(name) for name, words in SPECIAL_WORDS.items() for word in words.split()}
_CLASS_OF_TAG = {tag: number for number, tag in enumerate(TAGS)}


def part_of_speech(word: str, tag: str) -> int:
    """Returns the class number of a word: the class of the word if it is special, else that of its tag, else OTHER."""
    return _CLASS_OF_WORD.get(word, _CLASS_OF_TAG.get(tag, OTHER))


class WordIds(NamedTuple):
    """One caption, or several with a leading axis."""

    words: Int[Array | np.ndarray, "*batch S"]
    parts_of_speech: Int[Array | np.ndarray, "*batch S"]
    length: Int[Array | np.ndarray, "*batch"]
    """Number of words, with start and end but without padding."""


class Vocabulary:
    """The words that an evaluator knows, in the order of their numbers. Must contain `sos`, `eos` and `unk`."""

    def __init__(self, words: Sequence[str]):
        """Numbers the words in the given order.

        Raises:
            UserError: A word appears twice, or one of the three marks is missing.
        """
        self.words = tuple(words)
        self._number = {word: number for number, word in enumerate(self.words)}
        if len(self._number) < len(self.words):
            twice = Counter(self.words).most_common(1)[0][0]
            raise UserError(f"vocabulary: '{twice}' appears twice; remove one")
        for mark in (START, END, UNKNOWN):
            if mark not in self._number:
                raise UserError(f"vocabulary: '{mark}' is missing; add {START}, {END} and {UNKNOWN}")

    def __len__(self) -> int:
        return len(self.words)

    def __contains__(self, word: str) -> bool:
        return word in self._number

    def vectorize(self, tokens: Sequence[str]) -> WordIds:
        """Returns the word numbers of a caption of `word/TAG` tokens, padded to `TEXT_LENGTH`.

        Words are compared as they are spelled. An unknown word becomes `unk` of class OTHER, whatever its tag is. A
        known word without a known tag gets class OTHER, unless the word has a class of its own. Only the first
        `MAX_WORDS` tokens are read. A caption may be empty.
        """
        kept = [token.partition("/")[::2] for token in tokens[:MAX_WORDS]]
        sentence = [(START, ""), *kept, (END, "")]
        # The published vocabulary has no word for padding; its loader takes this one.
        words = np.full(TEXT_LENGTH, self._number[UNKNOWN], np.int32)
        classes = np.full(TEXT_LENGTH, OTHER, np.int32)
        for position, (word, tag) in enumerate(sentence):
            if word in self._number:
                words[position] = self._number[word]
                classes[position] = part_of_speech(word, tag)
        return WordIds(words, classes, np.array(len(sentence), np.int32))

    def vectorize_all(self, captions: Iterable[Sequence[str]]) -> WordIds:
        """Returns the word numbers of several captions.

        Raises:
            ValueError: There are no captions.
        """
        found = [self.vectorize(tokens) for tokens in captions]
        return WordIds(*(np.stack(arrays) for arrays in zip(*found, strict=True)))


def tokens_from_text(text: str) -> tuple[str, ...]:
    """Returns the words of a caption in lower case, without tags. They replace the tokens of a caption without any."""
    return tuple(re.findall(r"[^\W\d_]+", text.lower()))


def vocabulary_from_captions(captions: Iterable[Sequence[str]], *, min_count: int) -> Vocabulary:
    """Returns `sos`, `eos`, `unk` and then the words that captions (of tokens) use at least `min_count` times.

    Words are sorted by decreasing frequency. Equally frequent words are in alphabetical order.
    """
    counts = Counter(token.partition("/")[0] for tokens in captions for token in tokens)
    known = [word for word, count in counts.items() if count >= min_count and word.isalpha()]
    ordered = sorted(known, key=lambda word: (-counts[word], word))
    return Vocabulary((START, END, UNKNOWN, *(word for word in ordered if word not in (START, END, UNKNOWN))))


def load_vocabulary(path: Path) -> Vocabulary:
    """Returns the vocabulary of a text file with one word per line. The number of a word is the line's, from 0.

    Raises:
        UserError: The file cannot be read, has an empty line, or lacks one of the three marks.
    """
    lines = load_text(path).splitlines()
    for number, line in enumerate(lines, start=1):
        if not line or line != line.strip():
            raise UserError(f"{path}:{number}: empty, or with spaces around the word; write one word per line")
    try:
        return Vocabulary(lines)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None


def save_vocabulary(path: Path, vocabulary: Vocabulary) -> None:
    """Writes one word per line."""
    save_text(path, "".join(f"{word}\n" for word in vocabulary.words))


def load_word_vectors(path: Path, words: Sequence[str]) -> Float[np.ndarray, "W X"]:
    """Returns one vector per word, from a table (`.npy`, one row per word) or a GloVe text file.

    A GloVe file has lines `word v1 v2 ...`. Words that are not in it get random vectors, seeded by their spelling and
    with the standard deviation of the others. Their number is logged.

    Raises:
        UserError: The file cannot be read, is damaged, has another number of rows, or contains none of the words.
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
        # Not `hash`, which differs from process to process for texts.
        drawn = np.random.default_rng(zlib.crc32(word.encode())).normal(size=width)
        found[word] = (spread * drawn).astype(np.float32)
    return np.stack([found[word] for word in words])


def load_vector_table(path: Path) -> Float[np.ndarray, "W X"]:
    """Returns a table of word vectors from a `.npy` file, one row per word.

    Raises:
        UserError: The file cannot be read, or does not contain a table of finite numbers.
    """
    with np.errstate(over="ignore"):  # numbers that are too large become infinite, which is reported below
        table = load_array(path).astype(np.float32)
    if table.ndim != 2 or not table.size:
        raise UserError(f"{path}: has shape {list(table.shape)}; give a table with one row per word")
    if not np.isfinite(table).all():
        raise UserError(f"{path}: has values that are not finite")
    return table


def _glove_vectors(path: Path, words: frozenset[str]) -> dict[str, Float[np.ndarray, " X"]]:
    """Returns the vectors of the given words, without those that the GloVe file does not have."""
    found: dict[str, np.ndarray] = {}
    width = 0
    # The published files have gigabytes, so they are read line by line and only the given words are kept.
    with reading(path), path.open(encoding="utf-8") as file:
        for number, line in enumerate(file, start=1):
            word, _, rest = line.rstrip("\n").partition(" ")
            if word not in words or word in found:
                continue
            try:
                vector = np.array(rest.split(), np.float64)
            except ValueError as error:
                raise UserError(f"{path}:{number}: expected a word and numbers; give a GloVe text file") from error
            width = width or len(vector)
            if len(vector) != width or not width or not (np.abs(vector) < MAX_VALUE).all():
                raise UserError(f"{path}:{number}: expected a word and {width or 'some'} numbers below {MAX_VALUE:g}")
            found[word] = vector.astype(np.float32)
    return found
