"""Words with parts of speech and lemmas: the token field of captions.

The field follows HumanML3D. Hyphens are removed and only alphabetic words are used. A token is the lemma for nouns and
verbs (but "left" unchanged) and the word itself for all others, then a slash and the universal part-of-speech tag.
A general tagger is a heavy dependency. The words that matter in the project's own captions are in `lexicon.yaml`; the
tags of all others are guessed from their endings.
"""

import functools
import importlib.resources
import itertools
import re
from typing import Any

import yaml

from t2m_jax.text.verbs import inflected

TAGS = ("VBZ", "VBG", "VBD", "VBN")
"""Of the inflected forms of verbs: walks, walking, walked, walked."""
SIDES = frozenset({"left", "right"})


@functools.cache
def read_words(package: str, name: str) -> Any:
    """Returns the data of a YAML file of a package, by its name without the suffix. Do not change them."""
    text = (importlib.resources.files(package) / f"{name}.yaml").read_text(encoding="utf-8")
    # libyaml, where it is there, takes a tenth of the time.
    return yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))


def inflect(base: str, tag: str) -> str:
    """Returns a form of a verb by its Penn Treebank tag: for "run", "runs" (VBZ), "running" (VBG) or "ran" (VBD)."""
    # The file has those that the dictionary has otherwise; also wrong ones, where the benchmark's captions have them.
    return read_words(__package__, "lexicon")["other_forms"].get(base, {}).get(tag) or inflected(base, tag)


def _plural(noun: str) -> str:
    """Returns the plural of a regular noun."""
    # By rule and not by the dictionary, on whose plurals the typing mistakes of the benchmark's captions would depend.
    if noun.endswith(("s", "x", "z", "ch", "sh", "o")):
        return noun + "es"
    # "parties", but "boys".
    return noun[:-1] + "ies" if noun.endswith("y") and noun[-2] not in "aeiou" else noun + "s"


@functools.cache
def _readings() -> dict[str, dict[str, str]]:
    """Returns word -> {tag: lemma} for all forms of all words of the vocabulary."""
    lexicon = read_words(__package__, "lexicon")
    vocabulary = {tag: sorted(words.split()) for tag, words in lexicon["vocabulary"].items()}
    table: dict[str, dict[str, str]] = {}
    for base in vocabulary.pop("VERB"):
        for form in (base, *(inflect(base, tag) for tag in TAGS)):
            table.setdefault(form, {})["VERB"] = base
    nouns = [(form, noun) for noun in vocabulary.pop("NOUN") for form in (noun, _plural(noun))]
    for word, noun in (*nouns, *lexicon["irregular_nouns"].items()):
        table.setdefault(word, {})["NOUN"] = noun
    # Sorted, because the first reading counts if no rule prefers another.
    for tag in sorted(vocabulary):
        for word in vocabulary[tag]:
            table.setdefault(word, {})[tag] = word
    return table


@functools.cache
def known_words() -> frozenset[str]:
    """Returns all words of the files of this package, comments included, also in all forms of the vocabulary.

    Typing mistakes avoid them, so another word changes the captions of the benchmark. `more_words` are some that the
    files had when these were made.
    """
    files = [path for path in importlib.resources.files(__package__).iterdir() if path.name.endswith(".yaml")]
    return frozenset(_readings()).union(*(words_in(path.read_text(encoding="utf-8")) for path in files))


def words_in(text: str) -> list[str]:
    """Returns the alphabetic words of a sentence in lower case, without hyphens, as HumanML3D does."""
    return [word for word in re.findall(r"[^\W_]+", text.lower().replace("-", "").replace("'", "")) if word.isalpha()]


def _choose(readings: dict[str, str], previous: str, following: str) -> str:
    """Returns the tag of a word.

    Args:
        readings: Possible tags of the word, with its lemmas.
        previous: Tag of the word before it, or "".
        following: Word after it, or "".
    """
    if len(readings) == 1:
        return next(iter(readings))
    after = _readings().get(following, {})
    # "a straight line"
    if "ADJ" in readings and "NOUN" in after and previous in ("DET", "ADJ", "ADP", "NUM"):
        return "ADJ"
    # "a walk", "two steps"
    if previous in ("DET", "ADJ", "NUM") and "NOUN" in readings:
        return "NOUN"
    if "PART" in readings:
        # "begins to walk", but "to the left".
        return "PART" if after.get("VERB") == following else "ADP"
    if previous == "VERB" and "VERB" in readings and "ADV" in readings:
        return "ADV"
    if "DET" in readings and "NUM" not in readings:
        return "DET"
    if "ADP" in readings and ("DET" in after or "NOUN" in after or "PRON" in after):
        return "ADP"
    order = ("NUM", "VERB", "ADV", "SCONJ", "INTJ", "ADJ", "ADP", "PRON", "NOUN", "AUX")
    if previous in ("ADP", "PART") and "NOUN" in readings and "VERB" in readings:
        # "to step", but "in step".
        return "VERB" if previous == "PART" else "NOUN"
    return next(tag for tag in (*order, *readings) if tag in readings)


def tag_words(text: str) -> tuple[str, ...]:
    """Returns `word/TAG` for every alphabetic word of a caption: the third field of a HumanML3D line.

    The tag of a word that is not in the vocabulary is guessed from its ending.
    """
    words = words_in(text)
    table = _readings()
    tokens: list[str] = []
    previous = ""
    for word, following in itertools.zip_longest(words, words[1:], fillvalue=""):
        if word in SIDES:
            # An adjective before a noun, a noun after "the", else an adverb. "back" and nouns that are also adverbs
            # do not count: "turn left back" and "turn left forward" have adverbs.
            after = table.get(following, {})
            is_adjective = "NOUN" in after and "ADV" not in after and following != "back"
            previous = "ADJ" if is_adjective else "NOUN" if previous == "DET" else "ADV"
            tokens.append(f"{word}/{previous}")
            continue
        guess = {"NOUN": word}
        if word.endswith("ly"):
            guess = {"ADV": word}
        # Shorter words, such as "king", are seldom forms of a verb.
        elif word.endswith("ing") and len(word) > 5:
            guess = {"VERB": word[:-3]}
        # "dress" and "bus" are no plurals.
        elif word.endswith("s") and not word.endswith("ss") and len(word) > 3:
            guess = {"NOUN": word[:-1]}
        readings = table.get(word, guess)
        previous = _choose(readings, previous, following)
        tokens.append(f"{readings[previous]}/{previous}")
    return tuple(tokens)
