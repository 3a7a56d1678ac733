"""What an evaluator of a data set will not see of its captions: no fault, but worth knowing."""

from collections.abc import Callable, Iterable, Mapping, Sequence

from t2m_jax.data.caption_bank import caption_tokens
from t2m_jax.data.texts import Caption
from t2m_jax.text.word_vectors import MAX_WORDS, MIN_COUNT, UNKNOWN, Vocabulary, vocabulary_from_captions

Tokens = tuple[str, ...]


def caption_notes(captions: Mapping[str, Sequence[Caption]], *, training: Iterable[str]) -> list[str]:
    """Returns one line for captions that are read in part and one for captions without a word that is known.

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
        f"have no word that stands in {MIN_COUNT} training captions; an evaluator of this data knows none of them": (
            lambda row: not _knows_any(vocabulary, row)
        ),
    }
    notes = []
    for said, applies in checks.items():
        found = [name for name, rows in tokens.items() for row in rows if applies(row)]
        if found:
            notes.append(f"{len(found)} captions {said} (such as one of {found[0]})")
    return notes


def _knows_any(vocabulary: Vocabulary, row: Tokens) -> bool:
    """Returns whether a vocabulary has a word of a caption."""
    words = (token.partition("/")[0] for token in row)
    return any(word in vocabulary and word != UNKNOWN for word in words)
