"""Who moves in a caption: whether it asks for an animal or for several people, where a model has one person."""

import itertools
from collections.abc import Iterator, Sequence

from t2m_jax.text.verbs import AUXILIARIES, CLAUSE_STARTS, LIGHT_VERBS, PREPOSITIONS, SUBJECTS, Word, readings, word_set

ANIMALS = word_set(
    """alligator ant ape bear bee beetle bird bug bull butterfly camel cat caterpillar cheetah chicken chimp chimpanzee
    cow crab crocodile crow deer dinosaur dog dolphin donkey dove dragon duck eagle elephant ferret fish fly fox frog
    giraffe goat goose gorilla hamster hare hawk hedgehog hen hippo hippopotamus horse hyena insect jaguar kangaroo
    kitten koala lamb leopard lion lizard llama lobster monkey mosquito mouse mule octopus ostrich otter owl ox panda
    panther parrot peacock penguin pig pigeon pony puppy rabbit raccoon ram rat raven rhino rhinoceros rooster scorpion
    seal shark sheep sloth snail snake sparrow spider squirrel stag swan tiger toad tortoise turkey turtle unicorn
    wasp whale wolf worm zebra"""
)
THINGS = word_set(
    """airplane ball balloon bell bicycle bike boat book bottle bus car clock cloud cup curtain door elevator engine
    fire flag flower house lamp leaf machine moon phone plane rain river rocket ship snow sun table telephone tractor
    train tree truck van wagon wheel wind window"""
)
COMPARED = frozenset({"like", "as", "than", "pretend", "pretends", "pretending", "imitates", "imitating", "costume"})
"""Before an animal: "walks like a monkey"."""
_NO_SUBJECT = PREPOSITIONS | CLAUSE_STARTS
"""Words after which no subject of a sentence is looked for."""
NEAR = 4
"""Words before an animal among which a comparison is looked for."""
PERSON = word_set(
    """actor adult aunt baby boxer boy boyfriend brother character child dad dancer daughter fighter figure friend girl
    girlfriend grandfather grandma grandmother grandpa guy human husband kid lady man mom mother mum father neighbor
    neighbour opponent partner person player runner sister soldier son stranger student teacher teammate teenager twin
    uncle wife woman worker"""
)
"""In their basic forms."""
DOING = word_set("do execute perform")
"""Verbs before the name of an exercise."""
SEVERAL = word_set("two three four five six seven eight nine ten both several many some few couple pair group crowd")
CROWDS = word_set("people crowd duo trio couple everybody everyone team")
_ONE = word_set("he her him i me she you")
OTHERS = word_set("opponent partner")
"""Whom somebody moves with."""


def subject_problems(words: Sequence[Word]) -> Iterator[str]:
    """Yields what a model of one person cannot show of a caption, in words for a warning."""
    animal = _animal(words)
    if animal:
        yield f"{animal}: the model knows how people move, not animals"
    thing = _thing(words)
    if thing:
        yield f"{thing}: the model knows how people move, not things"
    several = _several(words)
    if several:
        yield f"{several}: one person moves, not several"


def _animal(words: Sequence[Word]) -> str:
    """Returns the first animal that moves, and is not met, carried or imitated."""
    has_person = False
    for place, word in enumerate(_subject(words)):
        # "Does a bear crawl", "a man in a bear suit"
        if not DOING.isdisjoint(word.bases) or (has_person and word.text in PREPOSITIONS):
            break
        has_person |= _is_person(word) or word.text in SUBJECTS
        following = readings(words[place + 1].text).keys() if place + 1 < len(words) else set()
        # "a dog walker"
        is_described = following == {"NOUN"}
        before = {other.text for other in words[max(place - NEAR, 0) : place]}
        if not ANIMALS.isdisjoint(word.bases) and not is_described and COMPARED.isdisjoint(before):
            return word.text
    return ""


def _thing(words: Sequence[Word]) -> str:
    """Returns the thing directly before the first action: "the old car turns", but not "a man in a car waves"."""
    before = _subject(words)
    subject = [word for word in before if word.text not in AUXILIARIES]
    is_other = any(_is_person(word) or word.text in _NO_SUBJECT | SUBJECTS for word in subject)
    rest = [word.text for word in words[len(before) :]]
    if not subject or not rest or is_other or THINGS.isdisjoint(subject[-1].bases):
        return ""
    # "Window cleaning" and "the ball is thrown by a man".
    is_done = "by" in rest or (rest[0].endswith("ing") and subject == before)
    return "" if is_done else subject[-1].text


def _subject(words: Sequence[Word]) -> list[Word]:
    """Returns the words before the first action."""
    return list(itertools.takewhile(lambda word: not word.action or word.action in LIGHT_VERBS, words))


def _several(words: Sequence[Word]) -> str:
    """Returns the words that ask for more than one person."""
    texts = [word.text for word in words]
    for pair in itertools.pairwise(texts):
        if pair in (("each", "other"), ("one", "another")):
            return " ".join(pair)
    subject = _subject(words)
    for place, word in enumerate(subject):
        before = subject[max(place - 3, 0) : place]
        first = next((at for at, other in enumerate(before) if other.text in SEVERAL), None)
        if first is not None and (word.text == "people" or (_is_person(word) and word.text not in PERSON)):
            return " ".join(texts[place - len(before) + first : place + 1])
        if _is_person(word) and _joins(subject[max(place - 4, 0) : place]):
            return f"and {' '.join(texts[place - 1 : place + 1])}"
        # "The kids jump", but not "as children do, he jumps".
        is_plural = _is_person(word) and word.text not in PERSON and texts[place - 1 : place] not in (["a"], ["an"])
        if is_plural and not any(other.text in _NO_SUBJECT | COMPARED for other in subject[:place]):
            return word.text
        # Not "a couple of steps".
        if word.text in CROWDS and texts[place + 1 : place + 2] != ["of"]:
            return word.text
    for word, other, person in zip(words, texts[1:], words[2:], strict=False):
        # "Carries another man", but not "walks up to another man".
        if word.action and other == "another" and _is_person(person):
            return f"another {person.text}"
    return next((text for text in texts if text in OTHERS), "")


def _joins(words: Sequence[Word]) -> bool:
    """Returns whether words before a person join another one to it: "a man and a", "me and my"."""
    return "and" in (word.text for word in words) and any(_is_person(word) or word.text in _ONE for word in words)


def _is_person(word: Word) -> bool:
    return not PERSON.isdisjoint(word.bases) and not word.action
