"""Typing mistakes in prompts: words that are no English words, and one letter away from one that a model knows."""

import re
import string
from collections.abc import Iterable, Iterator

from t2m_jax.text.verbs import (
    AUXILIARIES,
    CLAUSE_STARTS,
    DETERMINERS,
    PREPOSITIONS,
    SUBJECTS,
    forms,
    readings,
    word_set,
)

MOST_MISTAKES = 3
"""With more words that may be mistakes, a prompt is hardly English, and each costs hundreds of lookups."""
SHORTEST = 4
"""Letters of the shortest word that is corrected; shorter ones are one letter away from too many others."""
LONGEST = 30
"""Letters of the longest one. What is longer is no word, and looking for one would take seconds."""
# No parts of "doesn't" or "party-goer".
_WORD = re.compile(r"(?<![\w'-])[^\W\d_]+(?![\w'-])")
FOREIGN = word_set(
    """auf avec che com con das dem der dos due dans deux ein eine einem einen einer elle et ett gli hacia het il las
    les los mientras mit nach naar nicht och para puis qui sich um uma un una und une uno vers verso zum zur zwei een"""
)
"""Frequent words of other languages. Those that are English words, too, are looked for, but say nothing."""
_SPOKEN = word_set("gimme gonna gotta kinda lemme wanna")
_GRAMMAR = _SPOKEN | AUXILIARIES | CLAUSE_STARTS | DETERMINERS | PREPOSITIONS | SUBJECTS


def correct_spelling(
    prompt: str, known: frozenset[str], *, rare: frozenset[str] = frozenset()
) -> tuple[str, dict[str, str]]:
    """Returns a prompt without the typing mistakes that can be told, and what was read in place of which words.

    Args:
        prompt: A checked prompt.
        known: Words that may have been meant, in lower case; all forms of them may.
        rare: Those of them that hardly anybody means: they are no mistakes, but no mistake is read as one of them.
    """
    suspects = dict.fromkeys(found[0] for found in _WORD.finditer(prompt) if _may_be_mistake(found, known))
    if len(suspects) > MOST_MISTAKES or has_foreign_word(prompt.lower().split(), known):
        return prompt, {}
    read = {}
    for word in suspects:
        other = next((one for one in _one_mistake_away(word.lower()) if known & forms(one) - rare), None)
        if other is not None:
            read[word] = other
    return _WORD.sub(lambda found: read.get(found[0], found[0]), prompt), read


def has_foreign_word(words: Iterable[str], known: frozenset[str]) -> bool:
    """Returns whether words are in another language than English and those that a model knows."""
    return any(word in FOREIGN and word not in known and not readings(word) for word in words)


def _may_be_mistake(found: re.Match[str], known: frozenset[str]) -> bool:
    """Returns whether a word of a prompt is neither known, nor English, nor a name."""
    word = found[0].lower()
    # Capital letters inside of a sentence are names, or stand for something.
    is_name = found[0][0].isupper() and found.start() > 0
    # The dictionary lacks some plurals, such as "fours".
    is_plural = word.endswith("s") and not word.endswith("ss") and word[:-1] in known
    return not (
        is_name
        or not SHORTEST <= len(word) <= LONGEST
        or word in _GRAMMAR
        or word in known
        or is_plural
        or readings(word)
    )


def _one_mistake_away(word: str) -> Iterator[str]:
    """Yields what a word would be without one mistake, the most frequent kinds of mistakes first."""
    splits = [(word[:place], word[place:]) for place in range(len(word) + 1)]
    yield from (left + right[1] + right[0] + right[2:] for left, right in splits if len(right) > 1)
    # A letter that was left out: first such as were doubled ("runing").
    yield from (left + left[-1] + right for left, right in splits if left)
    yield from (left + letter + right for left, right in splits for letter in string.ascii_lowercase)
    yield from (left + right[1:] for left, right in splits if right)
    yield from (left + letter + right[1:] for left, right in splits if right for letter in string.ascii_lowercase)
