"""Captions about animals and about several people, which a model of one person cannot show."""

import pytest

from t2m_jax.text.subjects import subject_problems
from t2m_jax.text.verbs import words_of


def problems(caption):
    return list(subject_problems(words_of(caption)))


@pytest.mark.parametrize(
    ("caption", "animal"),
    [
        ("a dog runs across the yard", "dog"),
        ("the cats are sleeping", "cats"),
        ("make the horse gallop", "horse"),
        ("a small bird quickly flies away", "bird"),
        ("an elephant", "elephant"),
        ("In the park a dog runs", "dog"),
        ("a group of cats sleeps", "cats"),
    ],
)
def test_animals_that_move_are_named(caption, animal):
    assert problems(caption) == [f"{animal}: the model knows how people move, not animals"]


@pytest.mark.parametrize(
    "caption",
    [
        "a person walks like a monkey",
        "a man walks his dog",
        "somebody rides a horse",
        "the dog trainer waves",
        "as a cat would, she sneaks",
        "a person ducks",
        "a crane operator raises a hand",
        "a person does a bear crawl",
        "someone performs a duck walk",
        "doing donkey kicks",
        "a man in a bear suit walks",
        "a girl on a horse waves",
    ],
)
def test_people_with_animals_are_people(caption):
    assert problems(caption) == []


@pytest.mark.parametrize(
    ("caption", "named"),
    [
        ("two people shake hands", "two people"),
        ("three old men walk", "three old men"),
        ("they hug each other", "each other"),
        ("a group of children runs", "group of children"),
        ("people are dancing", "people"),
        ("a man and a woman dance", "and a woman"),
        ("he fights his opponent", "opponent"),
        ("a couple dances a waltz", "couple"),
        ("some kids jump", "some kids"),
        ("the soldiers march", "soldiers"),
        ("me and my friend walk", "and my friend"),
        ("everybody claps", "everybody"),
        ("a father and his daughter walk down the aisle", "and his daughter"),
        ("a fireman carries another man on his back", "another man"),
        ("the team runs onto the pitch", "team"),
    ],
)
def test_several_people_are_named(caption, named):
    assert problems(caption) == [f"{named}: one person moves, not several"]


@pytest.mark.parametrize(
    ("caption", "thing"),
    [
        ("a car turns left", "car"),
        ("the old red door opens", "door"),
        ("rain falls", "rain"),
        ("the flag is waving in the wind", "flag"),
    ],
)
def test_things_that_move_are_named(caption, thing):
    assert problems(caption) == [f"{thing}: the model knows how people move, not things"]


@pytest.mark.parametrize(
    "caption",
    [
        "a man in a car waves",
        "the ball is kicked twice by the goalkeeper",
        "kicks a ball",
        "window cleaning motion",
        "he opens the door",
        "as a bus drives by, she waves",
        "the bus driver waves",
        "a tree pose",
    ],
)
def test_people_with_things_are_people(caption):
    assert problems(caption) == []


@pytest.mark.parametrize(
    "caption",
    [
        "they walk",
        "a teacher walks up to another teacher",
        "a women sits down",
        "like children, he jumps",
        "a friend of the players waves",
        "a person takes two steps",
        "he raises both hands",
        "two waves",
        "a couple of steps and a wave",
        "a person walks and then a turn follows",
        "the man turns and the man waves",
        "he claps his hands together",
        "a person waves at people",
        "a man bows to the crowd",
    ],
)
def test_numbers_and_they_are_no_people(caption):
    assert problems(caption) == []
