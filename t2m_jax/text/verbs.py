"""The words of English captions, and which of them are actions: by a dictionary of word forms and rules of order.

A general tagger is a heavy dependency and confuses nouns and verbs where captions need it: in "a person jumps".
"""

import functools
import itertools
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from t2m_jax.text.prompts import straighten_quotes


def word_set(words: str) -> frozenset[str]:
    """Returns the words of a text."""
    return frozenset(words.split())


DETERMINERS = word_set(
    """a an the his her its their my your our this that these those some any each every both no another other few
    several many multiple one two three four five six seven eight nine ten"""
)
PREPOSITIONS = word_set(
    """in on at to from with of by for over under around into onto through toward towards along across near behind
    beside between like above below against off inside outside as than"""
)
CLAUSE_STARTS = word_set("and then while before after when or but who that how until so if because")
SUBJECTS = word_set("he she it they we you i somebody someone everybody everyone nobody people")
BEFORE_BASE_FORM = word_set("they we you i people not can will would should must could may let to")
"""Words after which a verb is in its basic form. After `to`, only if it cannot be a noun: "to school"."""
BODY_PARTS = word_set(
    """ankle arm back chest chin elbow eye face finger foot hand head heel hip knee leg mouth shoulder thigh toe
    waist wrist"""
)
BODY = BODY_PARTS | word_set("body fist gaze hip neck palm spine thumb torso trunk")
"""With those that only move as a part of a motion."""
SIDES = frozenset({"left", "right"})
"""Words that are sides in captions, never forms of `leave` or `right`."""
AUXILIARIES = word_set("am is are was were be been being has have had does did")
LIGHT_VERBS = word_set(
    "be begin come continue do end finish get have keep let make need perform please seem start take try use want"
)
"""Verbs that say nothing about the motion; another word does."""
PERFORMING_VERBS = word_set("do execute get give make perform take")
"""Verbs whose object is the action: "makes a jump"."""
GENERIC_NOUNS = word_set("action exercise gesture motion move movement pose position sequence")
"""Nouns that say nothing about the motion."""

NEGATION = r"\b(?:barely|hardly|instead of|neither|never|nobody|nor|not|rather than|without)\b"
"""Words before something that is not done."""

_TOKENS = re.compile(r"[^\W\d_]+(?:-[^\W\d_]+)*|\d+(?:[.,]\d+)?|[^\w\s'-]")


class Word(NamedTuple):
    """A word or a number of a caption."""

    text: str
    """In lower case."""
    bases: frozenset[str]
    """The word and its basic forms: `waves` and `wave`."""
    action: str
    """Basic form, if the word is a verb here or a noun for what a person does; otherwise empty."""


_NEGATED = {"can": "can not", "won": "will not", "shan": "shall not"}
"""What an irregular word before "'t" means."""


# With a limit, because a server is asked for any word, and spelling tries hundreds for one that it does not know.
@functools.lru_cache(maxsize=20_000)
def readings(word: str) -> dict[str, tuple[str, ...]]:
    """Returns the basic forms of an English word by part of speech; none for a word that is not in the dictionary."""
    from lemminflect import getAllLemmas  # imported when it is used: its dictionary takes a while to load

    return {} if word in SIDES else dict(getAllLemmas(word))


@functools.lru_cache(maxsize=20_000)
def inflected(word: str, tag: str) -> str:
    """Returns a form of an English word by its Penn Treebank tag: of `wave`, "waves" (VBZ) or "waving" (VBG)."""
    from lemminflect import getInflection  # imported when it is used, as in `readings`

    return next(iter(getInflection(word, tag)), word)


def form_of(verb: str) -> str:
    """Returns the Penn Treebank tag of a form of a verb: "waves" is VBZ. Participles of the past are VBD."""
    low = verb.lower()
    if low in readings(low).get("VERB", ()):
        return "VB"
    return "VBG" if low.endswith("ing") else "VBZ" if low.endswith("s") else "VBD"


def words_of(caption: str) -> list[Word]:
    """Returns the words and numbers of a caption, without punctuation; "can't" is "can not"."""
    text = re.sub(r"\b(can|won|shan)'t\b", lambda found: _NEGATED[found[1]], straighten_quotes(caption.lower()))
    text = re.sub(r"n't\b", " not", text)
    tokens = _TOKENS.findall(re.sub(r"'(s|re|ve|m|ll|d)\b", " ", text))
    starts = itertools.accumulate(token in CLAUSE_STARTS or not token[0].isalnum() for token in tokens)
    clauses = itertools.groupby(zip(starts, tokens, strict=True), key=lambda pair: pair[0])
    found: list[Word] = []
    for _, clause in clauses:
        words = [token for _, token in clause if token[0].isalnum()]
        found += [Word(text, forms(text), action) for text, action in zip(words, _actions(words), strict=True)]
    return found


def forms(word: str) -> frozenset[str]:
    """Returns a word and its basic forms."""
    return frozenset({word, *itertools.chain.from_iterable(readings(word).values())})


def bases_of(words: Iterable[Word]) -> frozenset[str]:
    """Returns the basic forms of words, and the words."""
    return frozenset().union(*(word.bases for word in words))


def is_negated(before: Sequence[Word]) -> bool:
    """Returns whether one of the last words of a clause says that what comes after them is not done."""
    return re.search(NEGATION, " ".join(clause_before(before, len(before)))) is not None


def clause_before(words: Sequence[Word], place: int) -> list[str]:
    """Returns up to four words before a place, as far as they are in its clause."""
    clause = itertools.takewhile(lambda word: word.text not in CLAUSE_STARTS, words[:place][:-5:-1])
    return [word.text for word in clause][::-1]


def _actions(clause: Sequence[str]) -> list[str]:
    """Returns the basic form of each word of a clause that is an action, and empty texts for the others."""
    words = [word for word in clause if word not in CLAUSE_STARTS]
    actions = [""] * (len(clause) - len(words))  # a word that starts a clause is its first
    has_verb = False
    is_object = False
    for index, word in enumerate(words):
        before = words[index - 1] if index else ""
        after = words[index + 1 :]
        has_verb = has_verb and word not in SUBJECTS
        is_verb = _is_verb(word, before, after, has_verb=has_verb)
        is_object = is_object and not is_verb and word not in PREPOSITIONS
        is_action = is_verb or (is_object and _is_action_noun(word, after))
        actions.append(readings(word)["VERB"][0] if is_action else "")
        is_object = is_object or (is_verb and actions[-1] in PERFORMING_VERBS) or word in ("does", "did")
        has_verb = has_verb or is_verb or word in AUXILIARIES
    return actions


def _is_verb(word: str, before: str, after: Sequence[str], *, has_verb: bool) -> bool:
    """Returns whether a word is a verb, by the word before it, those after it in its clause, and its own ending."""
    found = readings(word)
    bases = found.get("VERB", ())
    if not bases or word in AUXILIARIES or before in DETERMINERS or before[:1].isdigit():
        return False
    if word in bases:
        if not before:  # "jump forward", but not "drunk man walks" or "back to the wall"
            return "ADV" not in found and not any(map(_is_inflected, after))
        return before in BEFORE_BASE_FORM and not (before == "to" and "NOUN" in found)
    if word.endswith("ing"):
        return True
    if word.endswith("s"):  # the verb of the clause, or a noun
        return not has_verb and before not in PREPOSITIONS and BODY_PARTS.isdisjoint(bases)
    # A past form, or a word such as "tired" that only looks like one.
    return not ({"ADJ", "NOUN"} & found.keys() and (has_verb or not before))


def _is_action_noun(word: str, after: Sequence[str]) -> bool:
    """Returns whether a word in the object of a performing verb is the action: `wiping` or `jump`, but not `motion`."""
    found = readings(word)
    bases = {base for part in ("VERB", "NOUN") for base in found.get(part, ())}
    if "VERB" not in found or "ADV" in found or not bases.isdisjoint(BODY_PARTS | GENERIC_NOUNS):
        return False
    next_readings = readings(after[0]) if after else {}
    is_last = not after or after[0] in PREPOSITIONS or "NOUN" not in next_readings or "ADV" in next_readings
    return word.endswith("ing") or ("NOUN" in found and is_last)


def _is_inflected(word: str) -> bool:
    bases = readings(word).get("VERB", ())
    return word in AUXILIARIES or (bool(bases) and word not in bases and BODY_PARTS.isdisjoint(bases))
