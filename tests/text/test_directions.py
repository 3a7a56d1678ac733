"""Directions that sentences leave out, in the words of captions."""

import pytest

from t2m_jax.text.directions import with_directions
from t2m_jax.text.verbs import word_set

KNOWN = word_set("a person walk run stroll jog stagger forward to the")


@pytest.mark.parametrize(
    ("sentence", "read"),
    [
        # Without a gait.
        ("he returns", "he walks forward"),
        ("she ran back from the lake", "she ran forward from the lake"),
        ("she returned to the barn", "she walked forward to the barn"),
        ("a boy is coming over to the gate", "a boy is walking forward to the gate"),
        ("enter the cave", "walk forward into the cave"),
        ("Somebody exits the lift quickly", "Somebody walks forward out of the lift quickly"),
        ("a girl leaves the library", "a girl walks forward out of the library"),
        ("the pilot arrives at the plane", "the pilot walks forward to the plane"),
        ("a nurse approaches the bed", "a nurse walks forward to the bed"),
        ("she crossed the bridge", "she walked forward across the bridge"),
        ("a guest heads for the buffet", "a guest walks forward to the buffet"),
        ("made her way through the crowd", "walked forward through the crowd"),
        ("he sets off for the lake", "he walks forward for the lake"),
        # "Back" and "away" say where to.
        ("a person walks back to the shed", "a person walks forward to the shed"),
        ("the dog walker runs away", "the dog walker runs forward"),
        ("he jogs slowly off toward the woods", "he jogs forward slowly toward the woods"),
        ("she runs away from the wave", "she runs forward away from the wave"),
        ("a man strolled over to the well", "a man strolled forward to the well"),
        # With a direction, there is no second one.
        ("a person walks straight to the door", "a person walks straight to the door"),
        ("he goes forward to the altar", "he walks forward to the altar"),
    ],
)
def test_who_goes_somewhere_goes_forward(sentence, read):
    assert with_directions(sentence, KNOWN) == (read, {})


@pytest.mark.parametrize(
    ("sentence", "read", "gaits"),
    [
        ("a bear lumbers across the glade", "a bear walks forward across the glade", {"lumbers": "walks"}),
        ("skedaddling out of the barn", "running forward out of the barn", {"skedaddling": "running"}),
        ("he staggers along the quay", "he staggers forward along the quay", {}),
        ("someone ambles to the left", "someone walks forward and turns to the left", {"ambles": "walks"}),
    ],
)
def test_a_gait_that_no_caption_has_is_read_as_another(sentence, read, gaits):
    assert with_directions(sentence, KNOWN) == (read, gaits)


ACTIONS = word_set("clap jump stand turn walk")


@pytest.mark.parametrize(
    "sentence",
    [
        "startled by a bang, the cook spins around to look behind him",
        "the clerk turned around while standing at the counter",
        "the driver stops and turns to face the other way, without a word",
    ],
)
def test_who_only_turns_around_does_nothing_else(sentence):
    assert with_directions(sentence, KNOWN, ACTIONS)[0] == "a person turns around to the right on the spot"


def test_who_turns_around_and_does_something_else_does_both():
    for sentence in ("claps and turns around", "turns around clapping"):
        read, _ = with_directions(sentence, KNOWN, ACTIONS)
        assert "clap" in read and "turns around to the right on the spot" in read


@pytest.mark.parametrize(
    ("sentence", "read"),
    [
        ("he turns around", "he turns around to the right on the spot"),
        ("Turn round slowly", "turn around to the right on the spot slowly"),
        ("a cook turned about in place", "a cook turned around to the right in place"),
        ("turning to face the other way", "turning around to the right on the spot"),
        ("she does a half turn", "she turns around to the right on the spot"),
        ("he made an about-face", "he turned around to the right on the spot"),
        ("the lady whirled right around", "the lady turned around to the right on the spot"),
        ("a waiter pivots to look in the opposite direction", "a waiter turns around to the right on the spot"),
        ("a person rotates by 180\u00b0", "a person turns around to the right on the spot"),
        ("a person turns 180 degrees", "a person turns around to the right on the spot"),
    ],
)
def test_who_turns_around_does_so_on_the_spot(sentence, read):
    assert with_directions(sentence, KNOWN) == (read, {})


@pytest.mark.parametrize(
    ("sentence", "read"),
    [
        ("a person turns left", "a person walks forward and turns left"),
        ("Turn right!", "walk forward and turn right!"),
        ("the guests are turning to the right", "the guests are walking forward and turning to the right"),
        ("she slowly turned to her left side", "she slowly walked forward and turned to her left side"),
        ("a human makes a sharp left turn", "a human walks forward and makes a sharp left turn"),
        ("the guy took a right", "the guy walked forward and took a right"),
        ("the pilot starts to turn left a bit", "the pilot starts to walk forward and turn left a bit"),
        ("A leisurely turn to the left.", "a person walks forward and makes a leisurely turn to the left."),
        ("left turn", "a person walks forward and makes a left turn"),
        ("a boy veers off to the right", "a boy walks forward and veers off to the right"),
        ("someone goes right slowly", "someone walks forward and turns right slowly"),
        ("he is walking to the left", "he is walking forward and turning to the left"),
        ("she runs right", "she runs forward and turns right"),
    ],
)
def test_who_only_turns_or_goes_to_a_side_walks_around_a_corner(sentence, read):
    assert with_directions(sentence, KNOWN) == (read, {})


@pytest.mark.parametrize(
    "sentence",
    [
        "a person turns left on the spot",
        "stands there and turns left",
        "the seated man turns right",
        "does not turn left",
        "turns left and waves",
        "turns by 90 degrees to the left",
        "a half turn to the left",
        "he makes a u-turn to the left",
        "she does a full turn to the right",
        "rotates to the left",
        "his head turns left",
        "turns the key to the right",
        "the wheel turns right",
        "steps to the left",
        "looks left",
        "sideways walking to the left",
        "walks diagonally to the right",
        "takes right off",
        "the person on the left",
        "the left arm goes right",
    ],
)
def test_other_turns_to_a_side_are_no_walk(sentence):
    assert with_directions(sentence, KNOWN) == (sentence, {})


@pytest.mark.parametrize(
    "sentence",
    [
        "turns around the corner",
        "the captain turns the wheel around",
        "he turns around and around",
        "turns around to the left",
        "turns by a hundred and eighty degrees leftwards",
        "she turns around clockwise",
        "turns around three times",
        "a person walks on without turning around",
        "he turns around while walking",
        "a person walks",
        "he walks backward to the wall",
        "she backs away from the fire",
        "steps back from the edge",
        "he moves away",
        "a man walks with his back to the wall",
        "walks sideways along the ledge",
        "she turns and walks to the left",
        "he walks up the stairs",
        "walks back and forth along the fence",
        "jogs around the lake",
        "comes to a halt",
        "goes to sleep",
        "she goes back to stretching",
        "he returns to a standing position",
        "she goes through her exercises",
        "she moves her arms to the beat",
        "steps onto the box",
        "he crosses his arms",
        "crosses the fingers",
        "leaves a cup on the table",
        "enters a code",
        "he waves as she leaves the room",
        "the hands go up over the head",
        "he does not walk to the door",
        "a slow walk",
        "the exit is on fire",
        "throws the ball over to the goal",
        "leans over to the window",
        # Other angles than half a circle.
        "a person turns about 45 degrees to face the door",
        "a person turns around 360 degrees",
        "he turns around by ninety degrees",
        "he rotates around 45\u00b0",
    ],
)
def test_other_sentences_stay_as_they_are(sentence):
    assert with_directions(sentence, KNOWN) == (sentence, {})
