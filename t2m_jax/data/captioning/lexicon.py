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

SIDES = frozenset({"left", "right"})


@functools.cache
def read_words(package: str, name: str) -> Any:
    """Returns the data of a YAML file of a package, by its name without the suffix. Do not change them."""
    return yaml.safe_load((importlib.resources.files(package) / f"{name}.yaml").read_text(encoding="utf-8"))


def third_person(base: str) -> str:
    """Returns the third person singular of a regular English verb: "walks" for "walk"."""
    if base == "have":
        return "has"
    if base.endswith(("s", "x", "z", "ch", "sh", "o")):
        return base + "es"
    # "carries", but "sways".
    if base.endswith("y") and base[-2] not in "aeiou":
        return base[:-1] + "ies"
    return base + "s"


def gerund(base: str) -> str:
    """Returns the -ing form of a verb: "waving" for "wave", "running" for "run"."""
    if base in read_words(__package__, "lexicon")["doubled"].split():
        return base + base[-1] + "ing"
    # "waving", but "fleeing", "dyeing" and "tiptoeing".
    if base.endswith("ie"):
        return base[:-2] + "ying"
    if base.endswith("e") and not base.endswith(("ee", "ye", "oe")):
        return base[:-1] + "ing"
    return base + "ing"


def past(base: str) -> str:
    """Returns the past tense of a verb: "waved" for "wave", "ran" for "run"."""
    return _past_forms(base)[0]


def participle(base: str) -> str:
    """Returns the past participle of a verb: "waved" for "wave", "gone" for "go"."""
    return _past_forms(base)[-1]


def _past_forms(base: str) -> list[str]:
    """Returns the past tense of a verb and, if it differs, its past participle."""
    lexicon = read_words(__package__, "lexicon")
    if base in lexicon["irregular_verbs"]:
        return lexicon["irregular_verbs"][base].split()
    if base in lexicon["doubled"].split():
        return [base + base[-1] + "ed"]
    if base.endswith("y") and base[-2] not in "aeiou":
        return [base[:-1] + "ied"]
    return [base + ("d" if base.endswith("e") else "ed")]


@functools.cache
def _readings() -> dict[str, dict[str, str]]:
    """Returns word -> {tag: lemma} for all forms of all words of the vocabulary."""
    lexicon = read_words(__package__, "lexicon")
    vocabulary = {tag: sorted(words.split()) for tag, words in lexicon["vocabulary"].items()}
    table: dict[str, dict[str, str]] = {}
    for base in vocabulary.pop("VERB"):
        for form in (base, third_person(base), gerund(base), past(base), participle(base)):
            table.setdefault(form, {})["VERB"] = base
    nouns = [(form, noun) for noun in vocabulary.pop("NOUN") for form in (noun, third_person(noun))]
    for word, noun in (*nouns, *lexicon["irregular_nouns"].items()):
        table.setdefault(word, {})["NOUN"] = noun
    # Sorted, because the first reading counts if no rule prefers another.
    for tag in sorted(vocabulary):
        for word in vocabulary[tag]:
            table.setdefault(word, {})[tag] = word
    return table


@functools.cache
def known_words() -> frozenset[str]:
    """Returns all words of the files of this package, also in all forms of the vocabulary."""
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
