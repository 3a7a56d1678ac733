"""Clauses that mean something only together with the one before: "... and then lowers it", "... and then the right"."""

import itertools
import re
from collections.abc import Iterable, Sequence

from t2m_jax.text.numerals import OWNER
from t2m_jax.text.verbs import (
    AUXILIARIES,
    BODY,
    CLAUSE_STARTS,
    DETERMINERS,
    PREPOSITIONS,
    SIDES,
    SUBJECTS,
    Word,
    bases_of,
    forms,
    inflected,
    word_set,
    words_of,
)

_PARTICLES = word_set("away back down forward off out sideways up")
_BENDS = word_set("arch bend bow curl incline lean lunge nod stoop sway tilt")
"""Verbs for a posture that ends when the person is upright again."""
_TURNS = word_set("rotate turn twist")
"""The same of a part of the body."""
_UNBENDS = word_set("straighten unbend uncurl unfold unroll untwist unwind")
_UPRIGHT = word_set("erect neutral normal straight tall upright vertical")
_STANDS = word_set("be become come face get look resume return right rise stand")
_RETURNS = _UPRIGHT | word_set(
    "again back down drop fall hang loose lower original relax rest return settle sink still"
)
_ENDS = re.compile(
    rf"(?:(?:{'|'.join(sorted(SUBJECTS))}) )?(?:(?:lower|relax|return)(?:e?s|ed|ing)?(?: again)?$|"
    r"(?:lower|relax|return|drop)(?:e?s|p?ed|p?ing)? (?:it|them|(?:his|her|its|the|their|your|both) )|"
    r"return(?:s|ed|ing)? to (?:\w+ )?(?:start|side|rest|normal|neutral|standing|original|initial|first|same)|"
    r"put(?:s|ting)? (?:(?:his|her|its|the|their|your) )?\w+ away|repeat|back\b|step by|rights? \w+sel)",
    re.IGNORECASE,
)
"""What ends or repeats the action before, whatever that is."""
_OTHER = word_set("opposite other")
_FILLERS = (DETERMINERS | PREPOSITIONS | SUBJECTS | AUXILIARIES | CLAUSE_STARTS) - word_set(
    "both each every opposite other"
) | word_set(
    "again also direction do first follow just later likewise next now once only side start thing time too way well"
)
"""Words of a clause that says no more than another side: "then the same with the right one"."""
_SAME = re.compile(
    r"(?:(?:a|the|this|that) \w+ )?\b(?:do|does|did|doing|done)\b (?:first )?"
    r"(?:so|it|the same(?: thing)?|that|likewise|one)\b|"
    r"\b(?:the )?same(?: thing)?\b|\brepeat\w* (?:it |this |that )?",
    re.IGNORECASE,
)
"""Words in place of the verb of the other clause: "does the same"."""
_SIDE = re.compile(rf"\b(?:(?P<the>{OWNER}) )?(?P<side>left|right)\b(?: (?P<part>\w+)\b)?", re.IGNORECASE)
_THEN = re.compile(r",?(?: and)? then\b.*", re.IGNORECASE)
_NO_NOUN = re.compile(
    rf"(?<!\bat )(?<!\bon )(?<!\bto )(?<!\bfrom )\b(?P<side>{OWNER} (?:left|right))(?: one)?"
    r"(?=$|,| is\b| was\b| has\b)",
    re.IGNORECASE,
)
"""A side for which another clause may name the part of the body."""
_ONE = re.compile(r"\bone (?P<part>\w+)", re.IGNORECASE)


def only_ends(first: str, second: str) -> bool:
    """Returns whether a clause only ends the action of the clause before: "raises a hand" and "lets it sink"."""
    before = words_of(first)
    after = words_of(second)
    is_same_side = _sides(after) <= _sides(before) or not _sides(before)
    is_end = bool(_ENDS.match(second)) or _moves_it(before, after) or _brings_back(before, after)
    return _stands_again(before, after) or (is_same_side and is_end)


def _stands_again(before: Sequence[Word], after: Sequence[Word]) -> bool:
    """Returns whether a bend ends: "bows, then stands upright"."""
    first, second = bases_of(before), bases_of(after)
    bends = _BENDS & first or (_TURNS & first and BODY & first)
    return bool(bends and (_UNBENDS & second or (_UPRIGHT & second and _STANDS & second)))


def _moves_it(before: Sequence[Word], after: Sequence[Word]) -> bool:
    """Returns whether the part of the body that was moved is moved again: "lifts a leg, then puts it down"."""
    texts = [word.text for word in after]
    # A pronoun behind another thing is that thing ("raises a hand and waves it"), and the first word may be the person.
    names = list(itertools.takewhile(lambda text: text not in DETERMINERS, texts))
    pronouns = [text for earlier, text in itertools.pairwise(names) if earlier not in PREPOSITIONS]
    is_moved = texts[:1] in (["it"], ["they"]) and not (AUXILIARIES | _RETURNS).isdisjoint(bases_of(after[1:2]))
    is_about_it = is_moved or not {"it", "them"}.isdisjoint(pronouns)
    if BODY & bases_of(_subject(before)):
        # Without a subject of its own, a clause has that of the clause before.
        return is_about_it or (DETERMINERS | SUBJECTS).isdisjoint(texts[:1])
    return is_about_it and bool(BODY & bases_of(_object(before)))


def _brings_back(before: Sequence[Word], after: Sequence[Word]) -> bool:
    """Returns whether a part of the body goes back: "pulls the fist back", "the head comes up again"."""
    direct = list(itertools.takewhile(lambda word: word.text not in PREPOSITIONS, after))
    parts = [place for place, word in enumerate(direct) if BODY & word.bases]
    # "Back" alone says so: "throws a punch, then pulls the fist back".
    returns = _RETURNS if BODY & (bases_of(before) | bases_of(_subject(after))) else {"back"}
    return bool(parts) and not bases_of(after[parts[0] + 1 :]).isdisjoint(returns)


def _subject(words: Sequence[Word]) -> list[Word]:
    return list(itertools.takewhile(lambda word: not word.action and word.text not in AUXILIARIES, words))


def _object(words: Sequence[Word]) -> list[Word]:
    """Returns the first words after the verb that are no particle, up to a preposition: "the box", "the left hand"."""
    rest = words[len(_subject(words)) + 1 :]
    rest = list(itertools.dropwhile(lambda word: word.text in PREPOSITIONS | _PARTICLES or bool(word.action), rest))
    return list(itertools.takewhile(lambda word: word.text not in PREPOSITIONS, rest))


def fill_in(first: str, second: str) -> tuple[str, str] | None:
    """Returns two clauses of which one only names another side, in full; None if neither does so.

    "Waves with the left hand" and "the same with the right" become "waves with the left hand" and "waves with the right
    hand".
    """
    if _only_other_side(first):
        pair = None if _only_other_side(second) else _both_sides(second, first)
        return pair and pair[::-1]
    return _both_sides(first, second) if _only_other_side(second) else None


def name_part(clause: str, other: str) -> str:
    """Returns a clause with the part of the body that only the other one names: "the left" may be the left hand."""
    named = re.findall(r"\b(?:left|right) (\w+)", other, re.IGNORECASE)
    parts = [part for part in named if forms(part.lower()) & BODY]
    return _NO_NOUN.sub(rf"\g<side> {parts[0]}", clause) if parts else clause


def _only_other_side(clause: str) -> bool:
    """Returns whether a clause, up to a further "then", says no more than another side or both: "the left foot"."""
    said = _THEN.sub("", _SAME.sub(" ", clause))
    texts = [word for word in words_of(said) if not (_FILLERS | BODY) & word.bases]
    return len(texts) == 1 and texts[0].text in SIDES | _OTHER | {"both"}


def _both_sides(full: str, clause: str) -> tuple[str, str] | None:
    """Returns a clause, and the same for the side and the part of the body that another clause names."""
    full = re.sub(r",? first\b,?", "", full)
    rest = _THEN.search(clause)
    said = clause[: rest.start()] if rest else clause
    after = rest[0] if rest else ""
    words = words_of(said)
    named = _sides(words)
    is_both = any(word.text == "both" for word in words)
    if not _sides(words_of(full)) and not named and (one := _ONE.search(full)):  # "one hand, then the other"
        second = _both(one["part"]) if is_both else rf"the right {one['part']}"
        return full if is_both else _ONE.sub(r"the left \g<part>", full), _ONE.sub(second, full) + after
    # "Walks to the left and raises the right hand": only the hand has another side.
    places = list(_SIDE.finditer(full))
    places = [place for place in places if _part_of(place)] or places
    sides = {place["side"].lower() for place in places}
    parts = [word.text for word in words if BODY & word.bases]
    is_same = sides == named and set(parts) <= set(map(_part_of, places))
    # "Steps first left, then right, then left" is a way.
    needs_part = bool(parts or rest)
    if len(sides) != 1 or is_same or (needs_part and not all(map(_part_of, places))):
        return None
    side = next(iter(named or SIDES - sides))
    other = full
    for place in places[::-1]:  # the last first, so that the others keep their places
        part = parts[0] if parts else place["part"] or ""
        new = _both(part) if is_both else " ".join(filter(None, (place["the"], side, part)))
        other = f"{other[: place.start()]}{new}{other[place.end() :]}"
    return full, other + after


def _both(part: str) -> str:
    return f"both {inflected(part, 'NNS') if part.lower() in BODY else part}".rstrip()


def _part_of(place: re.Match[str]) -> str:
    """Returns the part of the body behind a side, empty if there is none."""
    part = (place["part"] or "").lower()
    return part if BODY & forms(part) else ""


def _sides(words: Iterable[Word]) -> set[str]:
    return {word.text for word in words} & SIDES
