"""Shapes of paths that a sentence asks for, and which option makes them."""

import pytest

from t2m_jax.text.coverage import Knowledge, check_coverage
from t2m_jax.text.meanings import Meanings
from t2m_jax.text.path_shapes import find_path_shape


@pytest.mark.parametrize(
    ("caption", "option"),
    [
        ("a person walks in a circle", "`turn` bends it, here by 360"),
        ("She jogged in large circles, clockwise.", "`turn` bends it, here by -360"),
        ("a man walks in a counterclockwise circle", "`turn` bends it, here by 360"),
        ("a man walks in a counter-clockwise circle", "`turn` bends it, here by 360"),
        ("run in a wide half circle to the right", "`turn` bends it, here by -180"),
        ("strolling along a quarter circle", "`turn` bends it, here by 90"),
        ("the woman zigzags across the yard", "`path` leads it through points"),
        ("somebody walks a figure eight", "`path` leads it through points"),
        ("marching in a square", "`path` leads it through points"),
        ("an old man walks in a curved line", "`path` leads it through points"),
        ("he runs a big loop around the lake", "`turn` bends it, here by 360"),
    ],
)
def test_a_shape_names_its_option(caption, option):
    assert find_path_shape(caption).option == f"the option {option}"


@pytest.mark.parametrize(
    "caption",
    ["a person walks in place", "running on the spot", "he hops and jogs on a treadmill", "march in one place"],
)
def test_going_on_the_spot_names_its_option(caption):
    assert find_path_shape(caption).option == "the option `in_place` removes the travel"


@pytest.mark.parametrize(
    "caption",
    [
        "turns on the spot",
        "hops in place",
        "stands in place",
        "a person swings the arms in circles while he walks",
        "she draws circles with a finger",
        "a man walks in the square",
        "a woman dances in a circle of friends",
        "a person walks forward",
        "he claps inside a circle",
        "a person draws a zigzag with one finger and walks on",
        "a man walks in a square hat",
        "she throws the ball in an arc and runs",
        "a man walks in a curve to the left",
    ],
)
def test_other_circles_are_no_path(caption):
    assert find_path_shape(caption) is None


WORDS = frozenset(["a", "person", "walks", "in", "circle", "walk"])


@pytest.mark.parametrize(
    ("words", "learned", "warns"),
    [
        (WORDS, (), False),
        (WORDS, ("a person walks forward",), True),
        (WORDS - {"circle"}, (), True),
        (WORDS - {"person"}, (), False),
    ],
    ids=["learned", "not in the grammar", "unknown", "another unknown word"],
)
def test_shapes_that_were_learned_do_not_warn(words, learned, warns):
    meanings = Meanings(("walk",), lambda sentences: [[1.0]] * len(sentences), learned=learned)
    prompt = "a person walks in a circle"
    said = check_coverage(prompt, Knowledge(words, ("walk",), meanings), read_part=prompt).warning
    assert ("circle: words do not shape the path; the option `turn` bends it, here by 360" in said) == warns
