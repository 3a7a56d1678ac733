"""Who moves in a caption: whether it asks for an animal or for several people, where a model has one person."""

from collections.abc import Iterator, Sequence

from t2m_jax.text.verbs import LIGHT_VERBS, Word, readings, word_set

ANIMALS = word_set(
    """alligator ant ape bear bee beetle bird bug bull butterfly camel cat caterpillar cheetah chicken chimp chimpanzee
    cow crab crocodile crow deer dinosaur dog dolphin donkey dove dragon duck eagle elephant ferret fish fly fox frog
    giraffe goat goose gorilla hamster hare hawk hedgehog hen hippo hippopotamus horse hyena insect jaguar kangaroo
    kitten koala lamb leopard lion lizard llama lobster monkey mosquito mouse mule octopus ostrich otter owl ox panda
    panther parrot peacock penguin pig pigeon pony puppy rabbit raccoon ram rat raven rhino rhinoceros rooster scorpion
    seal shark sheep sloth snail snake sparrow spider squirrel stag swan tiger toad tortoise turkey turtle unicorn
    wasp whale wolf worm zebra"""
)
COMPARED = frozenset({"like", "as", "than", "pretend", "pretends", "pretending", "imitates", "imitating", "costume"})
"""Before an animal: "walks like a monkey"."""
NEAR = 4
"""Words before an animal among which a comparison is looked for."""
PEOPLE = word_set(
    """people persons men women boys girls kids children friends guys adults dancers players fighters boxers soldiers
    actors students humans figures characters brothers sisters twins strangers runners workers teenagers ladies"""
)
SEVERAL = word_set("two three four five six seven eight nine ten both several many some few couple pair group crowd")
TOGETHER = (("each", "other"), ("one", "another"), ("another", "person"), ("another", "man"), ("another", "woman"))


def subject_problems(words: Sequence[Word]) -> Iterator[str]:
    """Yields what a model of one person cannot show of a caption, in words for a warning."""
    animal = _animal(words)
    if animal:
        yield f"{animal}: the model knows how people move, not animals"
    several = _several(words)
    if several:
        yield f"{several}: one person moves, not several"


def _animal(words: Sequence[Word]) -> str:
    """Returns the first animal that moves, and is not met, carried or imitated."""
    for place, word in enumerate(words):
        if word.action and word.action not in LIGHT_VERBS:
            return ""
        following = readings(words[place + 1].text).keys() if place + 1 < len(words) else set()
        # "a dog walker"
        is_described = following == {"NOUN"}
        before = {other.text for other in words[max(place - NEAR, 0) : place]}
        if not ANIMALS.isdisjoint(word.bases) and not is_described and COMPARED.isdisjoint(before):
            return word.text
    return ""


def _several(words: Sequence[Word]) -> str:
    """Returns the words that ask for more than one person."""
    texts = [word.text for word in words]
    for place, text in enumerate(texts):
        if tuple(texts[place : place + 2]) in TOGETHER:
            return " ".join(texts[place : place + 2])
        if text == "people" or (text in PEOPLE and not SEVERAL.isdisjoint(texts[max(place - 3, 0) : place])):
            first = next((at for at in range(max(place - 3, 0), place) if texts[at] in SEVERAL), place)
            return " ".join(texts[first : place + 1])
    return ""
