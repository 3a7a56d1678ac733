"""Captions that an evaluator trained on the data reads only in part or not at all. This is not a fault of the data."""

from collections.abc import Iterable, Mapping, Sequence

from t2m_jax.data.banks.captions import caption_tokens
from t2m_jax.data.texts import Caption
from t2m_jax.text.word_vectors import MAX_WORDS, MIN_COUNT, UNKNOWN, vocabulary_from_captions


def caption_notes(captions: Mapping[str, Sequence[Caption]], *, training: Iterable[str]) -> list[str]:
    """Returns notes about clips without captions, captions that are too long, and captions without a known word.

    Args:
        captions: All captions of each clip.
        training: Clips whose captions make the vocabulary.
    """
    tokens = {name: [caption_tokens(caption) for caption in found] for name, found in captions.items()}
    learned = (row for name in training for row in tokens.get(name, ()))
    vocabulary = vocabulary_from_captions(learned, min_count=MIN_COUNT)
    silent, long, unknown = [], [], []
    for name, rows in tokens.items():
        silent += [name] * (not rows)
        long += [name for row in rows if len(row) > MAX_WORDS]
        for row in rows:
            words = {token.partition("/")[0] for token in row} - {UNKNOWN}
            unknown += [name] * (not any(word in vocabulary for word in words))
    notes = {
        "clips have no caption that can be read, and nothing that reads captions uses them (such as {})": silent,
        f"captions have more than {MAX_WORDS} words, of which an evaluator reads the first {MAX_WORDS} "
        "(such as one of {})": long,
        f"captions have no word that training captions use {MIN_COUNT} times; an evaluator of this data knows none of "
        "their words (such as one of {})": unknown,
    }
    return [f"{len(names)} {note.format(names[0])}" for note, names in notes.items() if names]
