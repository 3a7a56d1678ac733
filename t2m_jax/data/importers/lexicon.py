"""The words that the project's own captions are made of, with parts of speech and lemmas.

The token field of a caption follows HumanML3D: hyphens removed, purely alphabetic words only, the lemma for nouns and
verbs (but "left" as it stands) and the surface form for all others, a slash and the universal part-of-speech tag.
A general tagger is a heavy dependency for a closed vocabulary, so the vocabulary is written down here.
"""

import importlib.resources
import re
from typing import NamedTuple


def _load_vocabulary() -> dict[str, frozenset[str]]:
    """Returns part of speech -> base forms, from the file beside this module."""
    text = importlib.resources.files("t2m_jax.data").joinpath("vocabulary.txt").read_text(encoding="utf-8")
    vocabulary: dict[str, frozenset[str]] = {}
    for line in text.splitlines():
        if not line.startswith("#"):
            tag, *words = line.split()
            vocabulary[tag] = vocabulary.get(tag, frozenset()) | frozenset(words)
    return vocabulary


VOCABULARY = _load_vocabulary()
"""Universal part of speech -> words: verbs in their base form, nouns in the singular."""


_DOUBLED = frozenset(
    {"begin", "bob", "cut", "get", "hit", "hop", "jab", "jog", "let", "nod", "put", "run", "sidestep", "spin", "squat"}
    | {"step", "stop", "trot"}
)
_PARTICIPLES = {
    "raised": "raise", "bent": "bend", "stretched": "stretch", "turned": "turn", "held": "hold", "lifted": "lift",
    "extended": "extend", "called": "call", "clasped": "clasp", "put": "put", "seen": "see", "worn": "wear",
    "done": "do", "kept": "keep", "given": "give", "made": "make", "taken": "take", "thrown": "throw", "filled": "fill",
}  # fmt: skip
_IRREGULAR_NOUNS = {
    "men": "man",
    "women": "woman",
    "people": "person",
    "children": "child",
    "feet": "foot",
    "degrees": "degree",
}
_SIDES = frozenset({"left", "right"})
_NOUN_CONTEXT = frozenset({"DET", "ADJ", "NUM"})


class WordForms(NamedTuple):
    """The three forms of a verb which captions use."""

    base: str
    third: str
    gerund: str


def third_person(base: str) -> str:
    """Returns the third person singular of a regular English verb: "walk" gives "walks"."""
    if base.endswith(("s", "x", "z", "ch", "sh", "o")):
        return base + "es"
    if base.endswith("y") and base[-2] not in "aeiou":
        return base[:-1] + "ies"
    return base + "s"


def gerund(base: str) -> str:
    """Returns the -ing form: "wave" gives "waving", "run" gives "running"."""
    if base in _DOUBLED:
        return base + base[-1] + "ing"
    if base.endswith("e") and not base.endswith(("ee", "ye", "oe")):
        return base[:-1] + "ing"
    return base + "ing"


def verb_forms(base: str) -> WordForms:
    """Returns the forms of a verb of the vocabulary.

    Raises:
        KeyError: the verb is not in `VOCABULARY`; a caption with it would have no tags.
    """
    if base not in VOCABULARY["VERB"]:
        raise KeyError(base)
    return WordForms(base, third_person(base), gerund(base))


def _make_table() -> dict[str, dict[str, str]]:
    """Returns word -> {tag: what is written for it}."""
    table: dict[str, dict[str, str]] = {}
    for base in sorted(VOCABULARY["VERB"]):
        for form in verb_forms(base):
            table.setdefault(form, {})["VERB"] = base
    for word, base in _PARTICIPLES.items():
        table.setdefault(word, {})["VERB"] = base
    for noun in sorted(VOCABULARY["NOUN"]):
        table.setdefault(noun, {})["NOUN"] = noun
        table.setdefault(third_person(noun), {})["NOUN"] = noun
    for word, noun in _IRREGULAR_NOUNS.items():
        table.setdefault(word, {})["NOUN"] = noun
    for tag in sorted(VOCABULARY.keys() - {"VERB", "NOUN"}):
        for word in sorted(VOCABULARY[tag]):
            table.setdefault(word, {})[tag] = word
    return table


_TABLE = _make_table()


def words_in(text: str) -> list[str]:
    """Returns the purely alphabetic words of a sentence, lower case, hyphens removed as HumanML3D does."""
    return [word for word in re.findall(r"[^\W_]+", text.lower().replace("-", "").replace("'", "")) if word.isalpha()]


def knows(word: str) -> bool:
    """Returns whether a lower-case word is in the vocabulary."""
    return word in _TABLE or word in _SIDES


def _guess(word: str) -> dict[str, str]:
    """Returns tags for a word outside the vocabulary, by its ending (captions that users bring)."""
    if word.endswith("ly"):
        return {"ADV": word}
    if word.endswith("ing") and len(word) > 5:
        return {"VERB": word[:-3]}
    if word.endswith("s") and not word.endswith("ss") and len(word) > 3:
        return {"NOUN": word[:-1]}
    return {"NOUN": word}


def _tag_side(previous: str, following: str) -> str:
    """Returns the tag of "left" or "right": an adjective before a noun, a noun after "the", else an adverb."""
    if "NOUN" in _TABLE.get(following, {}) and following not in ("back",) and "ADV" not in _TABLE.get(following, {}):
        return "ADJ"
    return "NOUN" if previous == "DET" else "ADV"


def _choose(readings: dict[str, str], previous: str, following: str) -> str:
    """Returns the tag for a word from its possible readings, the tag before it and the word after it."""
    if len(readings) == 1:
        return next(iter(readings))
    after = _TABLE.get(following, {})
    if "ADJ" in readings and "NOUN" in after and previous in ("DET", "ADJ", "ADP", "NUM"):
        return "ADJ"
    if previous in _NOUN_CONTEXT and "NOUN" in readings:
        return "NOUN"
    if "PART" in readings:
        return "PART" if after.get("VERB") == following else "ADP"
    if previous == "VERB" and "VERB" in readings and "ADV" in readings:
        return "ADV"
    if "DET" in readings and "NUM" not in readings:
        return "DET"
    if "ADP" in readings and ("DET" in after or "NOUN" in after or "PRON" in after):
        return "ADP"
    order = ("NUM", "VERB", "ADV", "SCONJ", "INTJ", "ADJ", "ADP", "PRON", "NOUN", "AUX")
    if previous in ("ADP", "PART") and "NOUN" in readings and "VERB" in readings:
        return "VERB" if previous == "PART" else "NOUN"
    return next(tag for tag in (*order, *readings) if tag in readings)


def tag_words(text: str, *, strict: bool = False) -> tuple[str, ...]:
    """Returns `word/TAG` for every alphabetic word of a caption, as the third field of a HumanML3D line wants it.

    Args:
        text: a caption.
        strict: refuse words outside the vocabulary in place of guessing their tag from the ending.

    Raises:
        KeyError: a word is unknown and `strict` is set.
    """
    words = words_in(text)
    tokens: list[str] = []
    previous = ""
    for word, following in zip(words, [*words[1:], ""], strict=True):
        if word in _SIDES:
            previous = _tag_side(previous, following)
            tokens.append(f"{word}/{previous}")
            continue
        if strict and word not in _TABLE:
            raise KeyError(word)
        readings = _TABLE.get(word) or _guess(word)
        previous = _choose(readings, previous, following)
        tokens.append(f"{readings[previous]}/{previous}")
    return tuple(tokens)
