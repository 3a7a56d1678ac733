"""What an evaluator of a data set will not see of its captions: no fault, but worth knowing."""

from collections.abc import Callable, Iterable, Mapping, Sequence

from t2m_jax.data.banks.captions import caption_tokens
from t2m_jax.data.texts import Caption
from t2m_jax.text.word_vectors import MAX_WORDS, MIN_COUNT, UNKNOWN, Vocabulary, vocabulary_from_captions

Tokens = tuple[str, ...]


def caption_notes(captions: Mapping[str, Sequence[Caption]], *, training: Iterable[str]) -> list[str]:
    """Returns one line each for clips without captions, captions read in part, and captions without a known word.

    Args:
        captions: All captions of each clip.
        training: Clips whose captions make the vocabulary.
    """
    tokens = {name: [caption_tokens(caption) for caption in found] for name, found in captions.items()}
    learned = (row for name in training for row in tokens.get(name, ()))
    vocabulary = vocabulary_from_captions(learned, min_count=MIN_COUNT)
    checks: dict[str, Callable[[Tokens], bool]] = {
        f"have more than {MAX_WORDS} words, of which an evaluator reads the first {MAX_WORDS}": (
            lambda row: len(row) > MAX_WORDS
        ),
        f"have no word that training captions use {MIN_COUNT} times; an evaluator of this data knows none of them": (
            lambda row: not _knows_any(vocabulary, row)
        ),
    }
    silent = [name for name, rows in tokens.items() if not rows]
    notes = []
    if silent:
        said = "clips have no caption that can be read, and nothing that reads captions uses them"
        notes.append(f"{len(silent)} {said} (such as {silent[0]})")
    for said, applies in checks.items():
        found = [name for name, rows in tokens.items() for row in rows if applies(row)]
        if found:
            notes.append(f"{len(found)} captions {said} (such as one of {found[0]})")
    return notes


def _knows_any(vocabulary: Vocabulary, row: Tokens) -> bool:
    """Returns whether a vocabulary has a word of a caption."""
    words = (token.partition("/")[0] for token in row)
    return any(word in vocabulary and word != UNKNOWN for word in words)
